"""Benchmarks: many cases in chunks, each finished chunk kept on disk, so that a run can resume."""

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from diffstack_mmv.checks import require, require_at_least, require_whole
from diffstack_mmv.simulation.chunks import (
    Chunk,
    Origin,
    cases_of,
    read_chunk_of,
    thoughts_in,
    write_chunk,
)
from diffstack_mmv.simulation.decisions import Controller, Decided, diagnosis_of, thoughts_of
from diffstack_mmv.simulation.episode import drive
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.simulation.phases import require_case
from diffstack_mmv.simulation.scene import CaseSource
from diffstack_mmv.simulation.world import World
from dmmv_conventions.libraries import libraries_loaded

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


@dataclass
class Timed:
    """A controller under a stop-watch of processor time: a busy machine does not count.

    Nor does what builds a library, once in a process: such a decision is made again for its time.

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
        known = libraries_loaded()
        start, decided = time.process_time(), self.controller.act(state, observation)
        if libraries_loaded() > known:
            start, decided = time.process_time(), self.controller.act(state, observation)
        running = max(int(observation.running.sum()), 1)
        self.seconds.append((time.process_time() - start) / running)
        return decided


@dataclass(frozen=True)
class Campaign:
    """Cases that a method drives.

    Attributes:
        method: Robot and controller.
        scenario: Where the cases come from.
        cases: Their numbers.
        folder: Where finished chunks are kept, one file each.
        chunk_size: Episodes per batch.
        phase: "train", "val" or "test".

    Raises:
        ValueError: There is no case, one is beyond the phase or named twice, or the chunks have no
            size.
    """

    method: Method
    scenario: CaseSource
    cases: Sequence[int]
    folder: Path
    chunk_size: int = 50
    phase: str = "test"

    def __post_init__(self) -> None:
        require(len(self.cases) > 0, "cases", "name at least one case", "none")
        for number in (min(self.cases), max(self.cases)):
            require_case(self.phase, number)
        twice = sorted(case for case, count in Counter(self.cases).items() if count > 1)
        told = ", ".join(map(str, twice))
        require(not twice, "cases", "name each case once", f"{told} more than once")
        require_whole("chunk_size", self.chunk_size)
        require_at_least("chunk_size", self.chunk_size, 1)

    def run(self) -> Iterator[Chunk]:
        """Drive chunk by chunk, or read the chunks that an earlier run has finished.

        Yields:
            The chunks in order.

        Raises:
            ValueError: A case does not exist, its start is impossible, or the folder holds chunks
                of other settings or of another version of the code.
        """
        origin = self._origin()
        for numbers, file in self._files():
            chunk = read_chunk_of(file, origin)
            if chunk is None or chunk.cases != numbers:
                chunk = self._driven(numbers)
                write_chunk(file, origin, chunk)
                chunk = chunk._replace(thoughts={})
            LOGGER.info("%s: cases %d to %d are done.", self.method.name, numbers[0], numbers[-1])
            yield chunk

    def require_same_origin(self) -> None:
        """Refuse a folder with chunks of anything else, before anything is driven.

        Other cases may lie there, but what reads the folder takes all of them for one campaign. So
        no case may be in two files: `remove_parts` takes away those that hold part of a chunk, any
        other one that shares cases with a chunk is in its way.

        Raises:
            ValueError: The folder holds chunks of other settings, of another phase or of another
                version of the code, or one that goes beyond a chunk of these cases.
        """
        origin = self._origin()
        for file in sorted(self.folder.glob("*.npz")):
            chunk = read_chunk_of(file, origin)
            if chunk is not None:
                self._require_apart(chunk.cases, file)

    def _require_apart(self, cases: list[int], file: Path) -> None:
        """Refuse cases of an earlier run that a chunk holds in part only."""
        for numbers, _ in self._files():
            beyond = set(cases) - set(numbers)
            apart = not beyond or beyond == set(cases)
            wanted = f"hold no other cases in a file with those from {numbers[0]} to {numbers[-1]}"
            remedy = f"Choose another `out`, drive those as well, or delete {file.parent}."
            found = f"cases {cases[0]} to {cases[-1]}"
            require(apart, "out", wanted, found, f"in {file}", remedy)

    def remove_parts(self) -> None:
        """Remove files of earlier runs all of whose cases stand in a finished chunk of this one."""
        finished = {file: set(numbers) for numbers, file in self._files() if file.is_file()}
        for file in set(self.folder.glob("*.npz")) - finished.keys():
            cases = set(cases_of(file, self._origin()))
            if cases and any(cases <= numbers for numbers in finished.values()):
                file.unlink()

    def thoughts(self, case: int) -> dict[str, Float[np.ndarray, "S ..."]]:
        """What the controller expected and planned in a finished case, see `read_thoughts`."""
        file = next(file for numbers, file in self._files() if case in numbers)
        return thoughts_in(file, case)

    def _origin(self) -> Origin:
        settings = f"{self.method.settings}\n{self.scenario!r}\nphase: {self.phase}"
        return Origin(self.method.code, settings)

    def _files(self) -> Iterator[tuple[list[int], Path]]:
        """Cases of each chunk, and where it is kept."""
        for first in range(0, len(self.cases), self.chunk_size):
            numbers = list(self.cases[first : first + self.chunk_size])
            yield numbers, self.folder / f"{self.phase}_{numbers[0]:05d}-{numbers[-1]:05d}.npz"

    def _driven(self, numbers: list[int]) -> Chunk:
        """Drive the cases as one batch."""
        controller = self.method.controller()
        timed = Timed(controller)
        scene = self.scenario.cases(self.phase, numbers)
        record, known = drive(self.method.world, scene, timed)
        shares = diagnosis_of(controller, known)
        told = {name: share.double().numpy() for name, share in shares.items()}
        thoughts = thoughts_of(controller, known)
        drawn = {"goal": scene.robot_goal.numpy(), "radius": scene.pedestrians.radius.numpy()}
        return Chunk(numbers, record, np.array(timed.seconds), told, thoughts, drawn)
