"""The jobs of a table: what is left of them, how long it takes, and what became of it."""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import NoReturn

from diffstack_mmv.commands.jobs import Job, Launcher
from dmmv_conventions.checks import message
from dmmv_conventions.progress import counted
from dmmv_conventions.versions import file_hash

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TableJobs:
    """Jobs whose results make one table.

    Attributes:
        stages: Jobs that run side by side; each stage needs those before.
        launcher: Where they run.
        table: What they are for, for the bar.
        unit: What one of them is.
    """

    stages: Sequence[Sequence[Job]]
    launcher: Launcher
    table: str
    unit: str

    @property
    def jobs(self) -> list[Job]:
        """All of them."""
        return [job for stage in self.stages for job in stage]

    def tell(self, guess: Mapping[str, float]) -> None:
        """Say how many are left, and how long they will take: kind -> seconds, if none has run."""
        still, width = [job for job in self.jobs if not job.done], self.launcher.width
        seconds = expected_seconds(self.jobs, self.jobs, guess, width)
        logger.info(
            "%d of %d %ss to do, %d at a time: about %.1f hours on cores like those measured "
            "before.", len(still), len(self.jobs), self.unit, width, seconds / 3600,
        )  # fmt: skip
        for job in still:
            logger.debug("%s", job.name)

    def complete(self, write: Callable[[list[str]], None]) -> None:
        """Run what is not done, and write the table, with a remark on each job without a result.

        Raises:
            ValueError: A job failed, which is told after the table is written.
        """
        failed = [
            job for stage in self.stages
            for job in run_all(self.launcher, stage, self.table, self.unit)
        ]  # fmt: skip
        write([why_failed(job) for job in failed])
        if failed:
            raise ValueError(
                f"{len(failed)} of {len(self.jobs)} {self.unit}s failed or were not begun. Read "
                "their logs, then give the same command again."
            )


def require_same_jobs(jobs: Sequence[Job]) -> None:
    """Refuse jobs whose result, or the part that there is of it, was made with other settings.

    Results of earlier versions, which kept no settings, or not what is in files, are taken as they
    are.

    Raises:
        ValueError: A setting of such a job differs, or a file that it names has changed.
    """
    hash_of = cache(file_hash)  # most jobs name the same files
    for job in (each for each in jobs if each.has_results and each.record.is_file()):
        told = json.loads(job.record.read_text(encoding="utf-8"))
        made = told.get("commands", job.settings)
        if made != job.settings:
            before, now = _first_difference(made, job.settings)
            _refuse(job, f"another setting than {now}", before)
        contents = told.get("files", {})
        for word, path in job.files.items():
            if contents.get(word, hash_of(path)) != hash_of(path):
                _refuse(job, f"another content of {word}", "what the file held before")


def _refuse(job: Job, other: str, found: str) -> NoReturn:
    remedy = f"Give another out=FOLDER, or delete {job.folder or job.result.parent}."
    wanted = f"hold no result of {job.name} with {other}"
    raise ValueError(message("out", wanted, found, f"in {job.record}", remedy))


def _first_difference(before: list[list[str]], now: list[list[str]]) -> tuple[str, str]:
    """The first argument that differs, before and now: of the same key, or none."""
    for first, second in zip_longest(before, now, fillvalue=[]):
        gone = [each for each in first if each not in second]
        new = [each for each in second if each not in first]
        if gone or new:
            key = (new or gone)[0].partition("=")[0]
            return _of_key(key, gone), _of_key(key, new)
    return "another order", "in this order"


def _of_key(key: str, arguments: list[str]) -> str:
    return next((each for each in arguments if each.partition("=")[0] == key), "none")


def run_all(launcher: Launcher, jobs: Sequence[Job], table: str, unit: str) -> list[Job]:
    """Run the jobs that are not done, and tell of each that ends.

    Args:
        launcher: Where they run.
        jobs: None of them needs another one.
        table: What they are for, for the bar.
        unit: What one of them is, for the bar.

    Returns:
        Those that failed, or were not begun since a result is lacking that they need.
    """
    still = [job for job in jobs if not job.done]
    failed = [job for job in still if job.lacking]
    able = [job for job in still if not job.lacking]
    for outcome in counted(launcher(able), table, unit, len(able)) if able else ():
        told = "" if outcome.succeeded else ", FAILED"
        logger.info("%s: %.0f s%s", outcome.job.name, outcome.seconds, told)
        if not outcome.succeeded:
            failed.append(outcome.job)
    return failed


def why_failed(job: Job) -> str:
    """Why there is no result."""
    if job.lacking:
        return f"{job.name} was not begun: {job.lacking[0]} is not there."
    return f"{job.name} failed: see {job.log}, which ends with: {_last_line(job.log)}"


def _last_line(log: Path) -> str:
    """What a command says last is why it failed, in one line."""
    said = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
    return said.strip().rpartition("\n")[2] or "nothing"


def expected_seconds(
    jobs: Sequence[Job], measured: Sequence[Job], guess: Mapping[str, float], width: int
) -> float:
    """How long the open jobs will take, from the finished ones of their kind, else from a guess.

    Args:
        jobs: Those to be run; finished ones take no time.
        measured: Jobs whose logs may tell what one of their kind took.
        guess: Kind -> seconds, where none was measured.
        width: How many run at a time.
    """
    spent: dict[str, list[float]] = {}
    for file in (job.record for job in measured):
        if file.is_file():
            told = json.loads(file.read_text(encoding="utf-8"))
            if "seconds" in told:  # not of a job that is still running, or was killed
                spent.setdefault(told["kind"], []).append(told["seconds"])
    each = {kind: sum(times) / len(times) for kind, times in spent.items()}
    still = [each.get(job.kind, guess.get(job.kind, 0.0)) for job in jobs if not job.done]
    return sum(still) / min(width, max(len(still), 1))
