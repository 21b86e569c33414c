"""Finished cases of a benchmark on disk, each file with what made it."""

import logging
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message
from diffstack_mmv.types import EpisodeRecord, Motion
from dmmv_conventions.archives import opened_arrays
from dmmv_conventions.disk import replacing

LOGGER = logging.getLogger(__name__)


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


def write_chunk(file: Path, origin: Origin, chunk: Chunk) -> None:
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
    chunk = read_chunk_of(file, None)
    if chunk is None:
        raise ValueError(message("file", "hold episodes of a benchmark", file))
    return chunk


def read_thoughts(folder: Path, case: int) -> dict[str, Float[np.ndarray, "S ..."]]:
    """What the controller expected and planned at each decision of a case, from stored episodes.

    Args:
        folder: Where a campaign keeps its chunks.
        case: Number of the case.

    Returns:
        Arrays by name, see `Thought`; empty where the controller tells nothing.
    """
    files = sorted(folder.glob("*.npz"))
    return next(filter(None, (thoughts_in(file, case) for file in files)), {})


def thoughts_in(file: Path, case: int) -> dict[str, Float[np.ndarray, "S ..."]]:
    """`read_thoughts` from one chunk; empty if it does not hold the case."""
    with opened_arrays(file) as stored:
        cases = stored["cases"].tolist()
        names = [name for name in stored.files if name.startswith("thoughts.") and case in cases]
        return {name.removeprefix("thoughts."): stored[name][cases.index(case)] for name in names}


class StoredEpisode(NamedTuple):
    """Where an episode stands among stored ones."""

    record: EpisodeRecord
    row: int


def read_episode(folder: Path, case: int) -> StoredEpisode:
    """Find a case among stored episodes.

    Args:
        folder: Where a campaign keeps its chunks.
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


def cases_of(file: Path, origin: Origin) -> list[int]:
    """Cases in a readable chunk of this origin, none in anything else."""
    try:
        with opened_arrays(file) as stored:
            made = {name: str(stored[f"origin.{name}"]) for name in Origin._fields}
            return stored["cases"].tolist() if made == origin._asdict() else []
    except ValueError:
        return []


def read_chunk_of(file: Path, origin: Origin | None) -> Chunk | None:
    """A chunk of this origin, if the file holds one; of any if none is given.

    Raises:
        ValueError: It is of another origin.
    """
    if not file.is_file():
        return None
    try:
        with opened_arrays(file) as stored:
            kept = (name for name in stored.files if not name.startswith("thoughts."))
            arrays = {name: stored[name] for name in kept}
        record = _record(arrays)
    except (ValueError, KeyError) as broken:
        LOGGER.warning("`%s` is not readable (%s) and is made anew.", file, broken)
        return None
    if origin is not None:
        _require_origin(file, arrays, origin)
    told, scene = _below("diagnosis.", arrays), _below("scene.", arrays)
    return Chunk(arrays["cases"].tolist(), record, arrays["step_s"], told, {}, scene)


def _below(prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays whose names begin so, by the rest of their names."""
    return {
        name.removeprefix(prefix): value
        for name, value in arrays.items()
        if name.startswith(prefix)
    }


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
