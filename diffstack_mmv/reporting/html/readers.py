"""Which files of a run become which sections."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from diffstack_mmv.reporting.files import told_as_broken
from diffstack_mmv.reporting.html.blocks import PICTURES, Gallery, Section
from diffstack_mmv.reporting.html.closed_loop import read_closed_loop
from diffstack_mmv.reporting.html.evaluation import read_evaluation
from diffstack_mmv.reporting.html.identification import read_identification
from diffstack_mmv.reporting.html.tables import read_tables, read_trajectories
from diffstack_mmv.reporting.html.training import read_training
from diffstack_mmv.reporting.scores import Scores
from dmmv_conventions.disk import UNFINISHED

PLACES = ("", "plots", "figures")


class Titles(NamedTuple):
    """Titles and units of the scores of both kinds of evaluation."""

    open_loop: Scores
    closed_loop: Scores


class RunPage(NamedTuple):
    """All that a page shows of one run."""

    name: str
    sections: list[Section]


def read_page(
    folder: Path, titles: Titles, episodes: int = 6, beside: Path | None = None
) -> RunPage:
    """Read whatever kinds of results a folder holds; what is absent is left out.

    Args:
        folder: Folder of a training, an evaluation, a drive, an identification, a comparison, ...
        titles: Titles and units of scores.
        episodes: How many closed-loop episodes the page can play, failures first.
        beside: Another closed-loop drive over the same cases, shown to the right of this one.

    Raises:
        ValueError: The folder holds none of these, or a file of it is broken.
    """
    readers: Sequence[Callable[[], list[Section]]] = (
        lambda: read_evaluation(folder, titles.open_loop),
        lambda: read_closed_loop(folder, titles.closed_loop, episodes, beside),
        lambda: read_identification(folder),
        lambda: read_tables(folder),
        lambda: read_trajectories(folder),
        lambda: read_training(folder),
        lambda: _pictures(folder),
    )
    with told_as_broken(folder):
        sections = [section for read in readers for section in read()]
    if not sections:
        raise ValueError(
            f"`runs` must name folders with results, but got none in {folder}. "
            "Give those that train, evaluate, navigate, identify, simulate or compare wrote."
        )
    return RunPage(folder.resolve().name, sections)


def names_apart(folders: Sequence[Path]) -> list[str]:
    """Name of each run: the end of its path, from where on no other run has the same.

    Args:
        folders: Folders of runs; one that is given twice has one name.
    """
    paths = [folder.resolve().parts for folder in folders]

    def name(path: tuple[str, ...]) -> str:
        others = [each for each in paths if each != path]
        ends = (path[-count:] for count in range(1, len(path) + 1))
        alone = (end for end in ends if all(each[-len(end) :] != end for each in others))
        return "/".join(next(alone, path))

    return [name(path) for path in paths]


def _pictures(folder: Path) -> list[Section]:
    """All figures that the run has drawn, those of one mode or case after the other."""
    files = [
        file
        for place in PLACES
        for file in sorted((folder / place).glob("*"))
        if file.suffix in PICTURES and UNFINISHED not in file.suffixes
    ]
    return [Section("Figures", [Gallery("", files)])] if files else []
