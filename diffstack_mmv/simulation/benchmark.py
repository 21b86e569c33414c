"""Benchmarks: many cases in chunks, each finished chunk kept on disk, so that a run can resume."""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require, require_at_least
from diffstack_mmv.simulation.decisions import Controller, Decided, diagnosis_of, thoughts_of
from diffstack_mmv.simulation.episode import drive
from diffstack_mmv.simulation.scenario import CaseSource
from diffstack_mmv.simulation.world import Observation, World
from diffstack_mmv.types import EpisodeRecord, Motion
from dmmv_conventions.disk import replacing

LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Method:
    """A robot with its controller, as one row of a table.

    Attributes:
        name: Name of the row, also of the folder of its episodes.
        world: Where it drives.
        controller: Makes a fresh controller.
        settings: Everything that decides the result, as text.
        code: Version of the code that drives.
    """

    name: str
    world: World
    controller: Callable[[], Controller]
    settings: str = ""
    code: str = ""


class Origin(NamedTuple):
    """What made a chunk; chunks of different origin are never mixed."""

    code: str
    settings: str


class Chunk(NamedTuple):
    """Some finished cases."""

    cases: list[int]
    record: EpisodeRecord
    step_s: Float[np.ndarray, " steps"]  # processor time of each decision per running episode
    diagnosis: dict[str, Float[np.ndarray, " E"]]  # per case, what the controller tells of itself
    # per case and decision, what it expected and planned; on disk only, empty when read back
    thoughts: dict[str, Float[np.ndarray, "E S *d"]]
    # per case, what pictures want to know: "goal" of the robot and "radius" of everybody in m
    scene: dict[str, Float[np.ndarray, "E _"]]


@dataclass
class Timed:
    """A controller under a stop-watch of processor time: a busy machine does not count.

    Attributes:
        controller: The controller.
        seconds: Processor time per decision and running episode in s, in the order of the calls.
    """

    controller: Controller
    seconds: list[float] = field(default_factory=list)

    def init(self, observation: Observation) -> Any:
        """As the controller begins."""
        return self.controller.init(observation)

    def act(self, state: Any, observation: Observation) -> Decided:
        """What the controller decides."""
        start = time.process_time()
        decided = self.controller.act(state, observation)
        running = max(int(observation.running.sum()), 1)
        self.seconds.append((time.process_time() - start) / running)
        return decided


def run(
    method: Method,
    scenario: CaseSource,
    cases: Sequence[int],
    folder: Path,
    chunk_size: int = 50,
    phase: str = "test",
) -> Iterator[Chunk]:
    """Drive cases chunk by chunk, or read the chunks that an earlier run has finished.

    Args:
        method: Robot and controller.
        scenario: Where the cases come from.
        cases: Their numbers.
        folder: Where finished chunks are kept, one file each.
        chunk_size: Episodes per batch.
        phase: "train", "val" or "test".

    Yields:
        The chunks in order.

    Raises:
        ValueError: There is no case, a case does not exist, its start is impossible, or the folder
            holds chunks of other settings or of another version of the code.
    """
    origin = _origin(method, scenario, phase)
    for numbers, file in _files(cases, folder, chunk_size, phase):
        chunk = _read(file, origin)
        if chunk is None or chunk.cases != numbers:
            chunk = _driven(method, scenario, numbers, phase)
            _write(file, origin, chunk)
            chunk = chunk._replace(thoughts={})
        LOGGER.info("%s: cases %d to %d are done.", method.name, numbers[0], numbers[-1])
        yield chunk


def require_same_origin(
    method: Method,
    scenario: CaseSource,
    cases: Sequence[int],
    folder: Path,
    chunk_size: int = 50,
    phase: str = "test",
) -> None:
    """Refuse what `run` would refuse of a folder, before anything is driven.

    Args:
        method: Robot and controller.
        scenario: Where the cases come from.
        cases: Their numbers.
        folder: Where finished chunks are kept.
        chunk_size: Episodes per batch.
        phase: "train", "val" or "test".

    Raises:
        ValueError: There is no case, or the folder holds chunks of other settings or of another
            version of the code.
    """
    origin = _origin(method, scenario, phase)
    for _, file in _files(cases, folder, chunk_size, phase):
        _read(file, origin)


def _origin(method: Method, scenario: CaseSource, phase: str) -> Origin:
    return Origin(method.code, f"{method.settings}\n{scenario!r}\n{phase}")


def _files(
    cases: Sequence[int], folder: Path, chunk_size: int, phase: str
) -> Iterator[tuple[list[int], Path]]:
    """Cases of each chunk, and where it is kept."""
    require(len(cases) > 0, "cases", "name at least one case", "none")
    require_at_least("chunk_size", chunk_size, 1)
    for first in range(0, len(cases), chunk_size):
        numbers = list(cases[first : first + chunk_size])
        yield numbers, folder / f"{phase}_{numbers[0]:05d}-{numbers[-1]:05d}.npz"


def _driven(method: Method, scenario: CaseSource, numbers: list[int], phase: str) -> Chunk:
    """Drive the cases as one batch."""
    controller = method.controller()
    timed = Timed(controller)
    scene = scenario.cases(phase, numbers)
    record, known = drive(method.world, scene, timed)
    shares = diagnosis_of(controller, known)
    told = {name: share.double().numpy() for name, share in shares.items()}
    thoughts = thoughts_of(controller, known)
    drawn = {"goal": scene.robot_goal.numpy(), "radius": scene.pedestrians.radius.numpy()}
    return Chunk(numbers, record, np.array(timed.seconds), told, thoughts, drawn)


def _write(file: Path, origin: Origin, chunk: Chunk) -> None:
    """Keep a chunk, all or nothing."""
    record = chunk.record
    arrays: dict[str, Any] = {"cases": chunk.cases, "step_s": chunk.step_s}
    arrays |= {f"origin.{name}": text for name, text in origin._asdict().items()}
    arrays |= {f"motion.{k}": v.detach().numpy() for k, v in record.motion._asdict().items()}
    for name, value in record._asdict().items():
        if isinstance(value, Tensor):
            arrays[name] = value.detach().numpy()
    arrays["dt_s"] = record.dt_s
    arrays |= {f"diagnosis.{name}": value for name, value in chunk.diagnosis.items()}
    arrays |= {f"thoughts.{name}": value for name, value in chunk.thoughts.items()}
    arrays |= {f"scene.{name}": value for name, value in chunk.scene.items()}
    with replacing(file) as unfinished, unfinished.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def read_chunk(file: Path) -> Chunk:
    """Read the episodes of a finished chunk.

    Raises:
        ValueError: The file is missing or none of a benchmark.
    """
    chunk = _read(file, None)
    if chunk is None:
        raise ValueError(message("file", "hold episodes of a benchmark", file))
    return chunk


def read_thoughts(folder: Path, case: int) -> dict[str, Float[np.ndarray, "S ..."]]:
    """What the controller expected and planned at each decision of a case, from stored episodes.

    Args:
        folder: Where `run` keeps the chunks.
        case: Number of the case.

    Returns:
        Arrays by name, see `Thought`; empty where the controller tells nothing.
    """
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as stored:
            cases = stored["cases"].tolist()
            if case in cases:
                row = cases.index(case)
                names = [name for name in stored.files if name.startswith("thoughts.")]
                return {name.removeprefix("thoughts."): stored[name][row] for name in names}
    return {}


class StoredEpisode(NamedTuple):
    """Where an episode stands among stored ones."""

    record: EpisodeRecord
    row: int


def read_episode(folder: Path, case: int) -> StoredEpisode:
    """Find a case among stored episodes.

    Args:
        folder: Where `run` keeps the chunks.
        case: Number of the case.

    Raises:
        ValueError: The case was not driven there.
    """
    for file in sorted(folder.glob("*.npz")):
        chunk = read_chunk(file)
        if case in chunk.cases:
            return StoredEpisode(chunk.record, chunk.cases.index(case))
    remedy = "Give a folder DIR/episodes/NAME that navigate wrote, and a case that it drove."
    raise ValueError(message("folder", f"hold case {case}", folder, "", remedy))


def _read(file: Path, origin: Origin | None) -> Chunk | None:
    """A chunk of this origin, if the file holds one; of any if none is given.

    Raises:
        ValueError: It is of another origin.
    """
    if not file.is_file():
        return None
    try:
        with np.load(file) as stored:
            kept = (name for name in stored.files if not name.startswith("thoughts."))
            arrays = {name: stored[name] for name in kept}
        record = _record(arrays)
    except (OSError, ValueError, KeyError, BadZipFile) as broken:
        LOGGER.warning("`%s` is not readable (%s) and is made anew.", file, broken)
        return None
    if origin is not None:
        _require_origin(file, arrays, origin)
    told = {
        name.removeprefix("diagnosis."): value
        for name, value in arrays.items()
        if name.startswith("diagnosis.")
    }
    scene = {
        name.removeprefix("scene."): value
        for name, value in arrays.items()
        if name.startswith("scene.")
    }
    return Chunk(arrays["cases"].tolist(), record, arrays["step_s"], told, {}, scene)


def _require_origin(file: Path, arrays: dict[str, np.ndarray], origin: Origin) -> None:
    """Refuse a chunk that other code, or other settings, have made."""
    for name, wanted in origin._asdict().items():
        found = str(arrays.get(f"origin.{name}", "unknown"))
        if found != wanted:
            lines = zip_longest(found.splitlines(), wanted.splitlines(), fillvalue="nothing")
            before, now = next((pair for pair in lines if pair[0] != pair[1]), (found, wanted))
            requirement = f"hold episodes of the same {name} ({now.strip()})"
            remedy = f"Choose another `out`, or delete {file.parent}."
            place = f"in {file}"
            raise ValueError(message("out", requirement, before.strip(), place, remedy))


def _record(arrays: dict[str, np.ndarray]) -> EpisodeRecord:
    """The record in stored arrays."""
    motion = Motion(*(torch.from_numpy(arrays[f"motion.{name}"]) for name in Motion._fields))
    rest = {
        name: torch.from_numpy(arrays[name])
        for name in EpisodeRecord._fields
        if name not in ("motion", "dt_s")
    }
    return EpisodeRecord(motion=motion, dt_s=float(arrays["dt_s"]), **rest)
