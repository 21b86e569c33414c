"""Pictures and animations of the episodes of a closed-loop run."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.plotting.animation import save_animation
from diffstack_mmv.plotting.episodes import CaseStart, draw_episode, episode_of
from diffstack_mmv.plotting.figures import save_figure
from diffstack_mmv.types import EpisodeRecord, Outcome


def save_stories(
    folder: Path,
    cases: Sequence[int],
    records: Sequence[EpisodeRecord],
    start_of: Callable[[int], CaseStart],
    count: int,
    chosen: Sequence[int] = (),
    outline: Float[Tensor, "corners 2"] | None = None,
    thoughts_of: Callable[[int], Mapping[str, Any]] | None = None,
    movie: str = "gif",
    control_names: tuple[str, ...] = (),
) -> None:
    """Draw and animate some episodes: those asked for, then failures, then the others.

    Args:
        folder: Receives plots/case_N.png and plots/case_N.gif or .mp4.
        cases: Numbers of the cases in the order of the records.
        records: Records, one after the other.
        start_of: Number of a case -> radii of the pedestrians and goal of the robot.
        count: Number of episodes to show besides those asked for.
        chosen: Cases asked for.
        outline: Polygon of the robot around its reference point in m; a disc of 0.3 m if None.
        thoughts_of: Number of a case -> what the controller expected and planned in it.
        movie: "gif", or "mp4" with the extra `video`.
        control_names: Of the controls of the robot.

    Raises:
        ValueError: A case asked for is none of these.
    """
    unknown = sorted(set(chosen) - set(cases))
    if unknown:
        told = f"{cases[0]} to {cases[-1]}"
        raise ValueError(f"`chosen` must name cases among {told}, but got {unknown}. Drive them.")
    places = [(record, row) for record in records for row in range(len(record.outcome))]
    outcomes = [int(record.outcome[row]) for record, row in places]
    asked = [index for index, case in enumerate(cases) if case in chosen]
    rest = [index for index in range(len(cases)) if index not in asked]
    rest.sort(key=lambda index: outcomes[index] == Outcome.SUCCESS)
    for index in [*asked, *rest[:count]]:
        record, row = places[index]
        case = cases[index]
        episode = episode_of(record, row, case, start_of(case), outline)
        episode = episode._replace(control_names=control_names)
        if thoughts_of is not None:
            episode = episode._replace(thoughts=thoughts_of(case))
        save_figure(draw_episode(episode), folder / "plots" / f"case_{case}.png")
        save_animation(episode, folder / "plots" / f"case_{case}.{movie}")
