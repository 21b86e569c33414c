"""Many command lines, side by side: on this machine or on a cluster, each done once."""

import json
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from diffstack_mmv.child_processes import ChildProcesses
from diffstack_mmv.command_line import quoted
from dmmv_conventions.checks import message, require_at_least
from dmmv_conventions.disk import replacing
from dmmv_conventions.extras import needs
from dmmv_conventions.progress import counted

logger = logging.getLogger(__name__)


class Job(NamedTuple):
    """Command lines to run one after the other, until their last one has written its result.

    Its result is that of its command lines: `require_same_jobs` refuses another one's.
    """

    name: str
    kind: str  # jobs of one kind take about as long
    commands: tuple[tuple[str, ...], ...]
    result: Path  # there as soon as the job is done
    log: Path
    needs: tuple[Path, ...] = ()  # results of other jobs, without which it is not begun
    folder: Path | None = None  # what it writes besides its log; null: the folder of the result
    root: Path | None = None  # of all jobs; it may be moved, so that its place is no setting
    partial: Path | None = None  # there as soon as it holds a part of the result of these settings

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.result.is_file()

    @property
    def has_results(self) -> bool:
        """Whether there is a result, or a part of it with which the job would go on."""
        return self.done or (self.partial is not None and self.partial.exists())

    @property
    def lacking(self) -> list[Path]:
        """What it needs and is not there."""
        return [path for path in self.needs if not path.is_file()]

    @property
    def settings(self) -> list[list[str]]:
        """Script and arguments of each command line, wherever Python and the folders are."""
        lines = ([Path(script).name, *rest] for _, script, *rest in self.commands)
        root = None if self.root is None else quoted(self.root)[1:-1]
        return [[each.replace(root, "OUT") if root else each for each in line] for line in lines]

    @property
    def record(self) -> Path:
        """File that tells how its result was made."""
        return self.log.with_suffix(".json")


class JobOutcome(NamedTuple):
    """How a job ended."""

    job: Job
    seconds: float
    succeeded: bool


def run_job(job: Job, children: ChildProcesses | None = None) -> JobOutcome:
    """Run the commands of a job, one thread each, until one fails; all they say goes to its log.

    Its record tells the settings from the beginning: who is killed cannot tell them at the end.
    """
    if children is None:
        with ChildProcesses() as own:
            return run_job(job, own)
    start = time.monotonic()
    job.log.parent.mkdir(parents=True, exist_ok=True)
    told: dict[str, Any] = {"kind": job.kind, "commands": job.settings}
    _write_record(job, told)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with job.log.open("a", encoding="utf-8") as log:
        for command in job.commands:
            if children.run(command, log, environment) != 0:
                break
    seconds = time.monotonic() - start
    if job.done:
        _write_record(job, told | {"seconds": seconds})
    return JobOutcome(job, seconds, job.done)


def _write_record(job: Job, told: Mapping[str, Any]) -> None:
    with replacing(job.record) as unfinished:
        unfinished.write_text(json.dumps(told), encoding="utf-8")


def require_same_jobs(jobs: Sequence[Job]) -> None:
    """Refuse jobs whose result, or the part that there is of it, was made with other settings.

    Results of earlier versions, which kept no settings, are taken as they are.

    Raises:
        ValueError: A setting of such a job differs.
    """
    for job in (each for each in jobs if each.has_results and each.record.is_file()):
        made = json.loads(job.record.read_text(encoding="utf-8")).get("commands")
        if made is None or made == job.settings:
            continue
        before, now = _first_difference(made, job.settings)
        where = f"in {job.record}"
        remedy = f"Give another out=FOLDER, or delete {job.folder or job.result.parent}."
        wanted = f"hold no result of {job.name} with another setting than {now}"
        raise ValueError(message("out", wanted, before, where, remedy))


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


@runtime_checkable
class Launcher(Protocol):
    """Where jobs run."""

    @property
    def width(self) -> int:
        """How many run at the same time."""
        ...

    def __call__(self, jobs: Sequence[Job]) -> Iterator[JobOutcome]:
        """Run all, and yield each one as soon as it ended."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Jobs in processes of this machine.

    Args:
        processes: How many at a time.
    """

    processes: int = 2

    def __post_init__(self) -> None:
        require_at_least("processes", self.processes, 1)

    @property
    def width(self) -> int:
        """The number of processes."""
        return self.processes

    def __call__(self, jobs: Sequence[Job]) -> Iterator[JobOutcome]:
        """Run all, and yield each one as soon as it ended.

        Where it is interrupted, what runs is told to end, and nothing else is begun.
        """
        with ThreadPoolExecutor(self.processes) as pool, ChildProcesses() as children:
            yield from _ended([pool.submit(run_job, job, children) for job in jobs])


@dataclass(frozen=True)
class Slurm:
    """Jobs of a SLURM cluster, through submitit.

    Args:
        folder: What submitit writes.
        parameters: Its parameters, e.g. `timeout_min`, `slurm_partition`; null ones are left out.
        cluster: `local` runs them here in submitit's own processes, to try it; null finds SLURM.

    Raises:
        MissingExtraError: submitit is not installed.
    """

    folder: str
    parameters: Mapping[str, Any]
    cluster: str | None = None

    def __post_init__(self) -> None:
        with needs("sweep", "launcher=slurm"):
            import submitit  # pyright: ignore[reportMissingImports]  # noqa: F401

    @property
    def width(self) -> int:
        """As many as the cluster takes: for an estimate of time, ten."""
        return 10

    def __call__(self, jobs: Sequence[Job]) -> Iterator[JobOutcome]:
        """Submit all, and yield each one as soon as it ended."""
        import submitit  # an extra  # pyright: ignore[reportMissingImports]

        executor = submitit.AutoExecutor(self.folder, cluster=self.cluster)
        given = {name: value for name, value in self.parameters.items() if value is not None}
        executor.update_parameters(**given)
        submitted = executor.map_array(run_job, list(jobs))
        with ThreadPoolExecutor(max(len(submitted), 1)) as waiting:
            yield from _ended([waiting.submit(job.result) for job in submitted])


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


def why_failed(job: Job) -> str:
    """Why there is no result."""
    if job.lacking:
        return f"{job.name} was not begun: {job.lacking[0]} is not there."
    return f"{job.name} failed: see {job.log}, which ends with: {_last_line(job.log)}"


def _last_line(log: Path) -> str:
    """What a command says last is why it failed, in one line."""
    said = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
    return said.strip().rpartition("\n")[2] or "nothing"


def _ended(futures: list[Future[JobOutcome]]) -> Iterator[JobOutcome]:
    for future in as_completed(futures):
        yield future.result()


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
