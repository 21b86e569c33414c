"""One fault, and what became of it."""

import traceback
from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from data_converters import ConversionError, ConversionSettings, convert
from data_converters.recordings import RecordingDataset
from data_converters.report import ConversionReport
from diffstack_mmv.commands.failures import EXPECTED


class Result(StrEnum):
    """What became of a fault; the last three must not happen."""

    REFUSED = "refused with one message"
    REPORTED = "converted with report"
    HELD = "no harm done"
    LOST = "lost"
    SILENT = "silent"
    TRACEBACK = "traceback"


class Trial(NamedTuple):
    """A fault: its kind and name, and what tries it in a folder of its own."""

    kind: str
    name: str
    run: Callable[[Path], Result]


class Told(NamedTuple):
    """A fault with its result and what was said."""

    trial: Trial
    result: Result
    message: str


def attempt(trial: Trial) -> Told:
    """Try a fault; an error is a message where a command would tell it as one."""
    with TemporaryDirectory() as folder:
        try:
            return Told(trial, trial.run(Path(folder)), "")
        except EXPECTED as error:
            told = str(error)
            return Told(trial, Result.REFUSED if is_message(told) else Result.TRACEBACK, told)
        except Exception:  # noqa: BLE001  whatever it is, it is what this looks for
            return Told(trial, Result.TRACEBACK, traceback.format_exc())


OF_OTHERS = (
    "Could not override", "Could not append", "Error merging", "unexpected keyword argument",
    "Invalid learning rate", "[Errno", "Ambiguous value",
)  # fmt: skip
"""Remarks of Hydra, torch and the system that name what is wrong too."""


def is_message(told: str) -> bool:
    """Whether it names what is wrong, as ours do, or is a remark from somewhere within."""
    return "`" in told or any(words in told for words in OF_OTHERS)


class Usual(NamedTuple):
    """What a conversion tells of whole recordings: tracks left out, and counts of its notes."""

    rejected: int = 0
    noted: int = 0


def told_by(report: ConversionReport) -> Usual:
    """Tracks left out, and the sum of all notes."""
    rejected = {item["track"] + item["source"] for s in report.scenes for item in s.rejected}
    return Usual(len(rejected), sum(sum(scene.notes.values()) for scene in report.scenes))


def converted(
    dataset: RecordingDataset, folder: Path, good: int, usual: Usual | None = None
) -> Result:
    """Convert recordings with `good` tracks and a broken one, of which more than usual is told."""
    try:
        report = convert(ConversionSettings(dataset, folder / "cache", progress=False))
    except ConversionError:
        # a message, but the good tracks are gone with the bad one
        return Result.LOST
    kept = sum(sum(scene.agents.values()) for scene in report.scenes)
    if kept < good:
        return Result.LOST
    told, before = told_by(report), usual or Usual()
    more = told.rejected > before.rejected or told.noted > before.noted
    return Result.REPORTED if more else Result.SILENT


def each(kind: str, faults: Iterable[tuple[str, Callable[[Path], Result]]]) -> Iterator[Trial]:
    """Trials of one kind."""
    return (Trial(kind, name, run) for name, run in faults)
