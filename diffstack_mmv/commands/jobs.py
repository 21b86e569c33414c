"""Many command lines, side by side: on this machine or on a cluster, each done once."""

import json
import logging
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from diffstack_mmv.commands.child_processes import ChildProcesses
from diffstack_mmv.commands.command_line import quoted
from dmmv_conventions.checks import message, require, require_at_least
from dmmv_conventions.disk import replacing
from dmmv_conventions.extras import needs
from dmmv_conventions.versions import file_hash

logger = logging.getLogger(__name__)

_LOOK_S = 1.0
"""Time in s between two looks at the jobs of a cluster."""


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
    def files(self) -> dict[str, Path]:
        """Files by the settings that name them, such as a vehicle; none that jobs have written."""
        words = (word for line in self.settings for word in line)
        named = {word: word.partition("=")[2].strip("'\"") for word in words}
        return {word: Path(name) for word, name in named.items() if os.path.isfile(name)}

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

    What one that fails has written in place of the result is kept as `failed_NAME`. The record
    tells the settings from the beginning: who is killed cannot tell them at the end.
    """
    if children is None:
        with ChildProcesses() as own:
            return run_job(job, own)
    start = time.monotonic()
    job.log.parent.mkdir(parents=True, exist_ok=True)
    contents = {word: file_hash(path) for word, path in job.files.items()}
    told: dict[str, Any] = {"kind": job.kind, "commands": job.settings, "files": contents}
    _write_record(job, told)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with job.log.open("a", encoding="utf-8") as log:
        failed = any(children.run(command, log, environment) != 0 for command in job.commands)
    seconds = time.monotonic() - start
    if failed and job.done:  # such as the report of a conversion that found nothing to use
        job.result.replace(job.result.with_name(f"failed_{job.result.name}"))
    if job.done:
        _write_record(job, told | {"seconds": seconds})
    return JobOutcome(job, seconds, job.done)


def _write_record(job: Job, told: Mapping[str, Any]) -> None:
    with replacing(job.record) as unfinished:
        unfinished.write_text(json.dumps(told), encoding="utf-8")


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
        """Submit all, and yield each one as soon as it ended.

        One that the cluster ended, for its time or memory, has failed, and the others go on. Where
        this is interrupted, those that have not ended are cancelled.

        Raises:
            ValueError: There is no cluster, or it refuses the jobs.
        """
        start = time.monotonic()
        waiting = list(zip(self._submitted(jobs), jobs, strict=True))
        try:
            while waiting:
                ended = [number for number, (each, _) in enumerate(waiting) if each.done()]
                for number in reversed(ended):
                    yield _outcome(*waiting.pop(number), start)
                if not ended:
                    time.sleep(_LOOK_S)
        finally:
            for each, _ in waiting:
                each.cancel(check=False)

    def _submitted(self, jobs: Sequence[Job]) -> list[Any]:
        """What submitit makes of each job."""
        import submitit  # an extra  # pyright: ignore[reportMissingImports]

        # submitit would run all of them here, at the same time
        there = self.cluster is not None or shutil.which("srun") is not None
        remedy = (
            "launcher=local runs the jobs here, some at a time; launcher.cluster=local tries it."
        )
        require(
            there, "launcher", "be slurm where srun is found", "nothing of that name", "", remedy
        )
        given = {name: value for name, value in self.parameters.items() if value is not None}
        try:
            executor = submitit.AutoExecutor(self.folder, cluster=self.cluster)
            executor.update_parameters(**given)
            return executor.map_array(run_job, list(jobs))
        except (RuntimeError, NameError, AssertionError) as refused:
            wanted, found = "be what the cluster takes", " ".join(str(refused).split())
            raise ValueError(message("launcher.parameters", wanted, found)) from refused


def _outcome(submitted: Any, job: Job, start: float) -> JobOutcome:
    """How a job of a cluster ended."""
    try:
        return submitted.result()
    except RuntimeError as error:  # of submitit: time, memory or a node was lost
        lines = str(error).strip().splitlines() or [type(error).__name__]
        logger.warning("%s: %s", job.name, " ".join(lines[:2]))
        return JobOutcome(job, time.monotonic() - start, job.done)


def _ended(futures: list[Future[JobOutcome]]) -> Iterator[JobOutcome]:
    for future in as_completed(futures):
        yield future.result()
