"""Which episodes of a closed-loop run are drawn, and their files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from diffstack_mmv.plotting.animation import save_animation
from diffstack_mmv.plotting.episodes import Episode, draw_episode
from diffstack_mmv.plotting.figures import save_figure
from diffstack_mmv.types import Outcome


def worth_showing(outcomes: Mapping[int, int], count: int, asked: Sequence[int] = ()) -> list[int]:
    """Cases to draw: those asked for, then failures, then the others.

    Args:
        outcomes: Number of a case -> its `Outcome`.
        count: Number of cases besides those asked for.
        asked: Cases asked for.

    Raises:
        ValueError: A case asked for is none of these.
    """
    cases = list(outcomes)
    unknown = sorted(set(asked) - set(cases))
    if unknown:
        told = f"{cases[0]} to {cases[-1]}"
        raise ValueError(f"`asked` must name cases among {told}, but got {unknown}. Drive them.")
    rest = [case for case in cases if case not in asked]
    rest.sort(key=lambda case: outcomes[case] == Outcome.SUCCESS)
    return [*(case for case in cases if case in asked), *rest[:count]]


def save_story(folder: Path, episode: Episode, movie: str = "gif") -> None:
    """Draw and animate an episode.

    Args:
        folder: Receives plots/case_N.png and plots/case_N.gif or .mp4.
        episode: The episode.
        movie: "gif", or "mp4" with the extra `video`.
    """
    name = folder / "plots" / f"case_{episode.case}"
    save_figure(draw_episode(episode), name.with_suffix(".png"))
    save_animation(episode, name.with_suffix(f".{movie}"))
