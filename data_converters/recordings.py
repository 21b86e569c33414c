"""What a data set has to offer to be converted: its scenes, and the tracks of one of them."""

from __future__ import annotations

import gzip
import hashlib
import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple

import pandas as pd

from data_converters.errors import RejectReason, TrackError
from data_converters.limits import RecordingLimits
from data_converters.plain_files import require_plain
from data_converters.tracks import RawTrack


class SceneSource(NamedTuple):
    """One scene before it is read.

    `key` is whatever its data set finds it by, `fingerprint` changes when its files change.
    Scenes that name one `recording` are parts of it and resemble each other; "" is one of its own.
    """

    name: str
    split: str
    key: str
    fingerprint: str
    recording: str = ""


class Rejection(NamedTuple):
    """A track that did not make it into the cache."""

    track: str
    source: str
    reason: RejectReason
    detail: str


@dataclass
class RawScene:
    """The tracks of one scene on one clock that starts at 0 s.

    Attributes:
        tracks: Usable tracks.
        rejected: Tracks refused while reading.
        side_tables: Tables trajdata has no place for, by file stem; written as parquet.
        signals: Traffic lights as trajdata keeps them: lane_id, scene_ts, status; or None.
        notes: Counts worth reporting, such as rows dropped while reading.
    """

    tracks: list[RawTrack] = field(default_factory=list)
    rejected: list[Rejection] = field(default_factory=list)
    side_tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    signals: pd.DataFrame | None = None
    notes: dict[str, int] = field(default_factory=dict)

    def reject(self, track: str, source: str, error: TrackError, *, strict: bool) -> None:
        """Count a refused track, or raise its error where the conversion is strict.

        Raises:
            TrackError: `error`, if `strict`.
        """
        if strict:
            raise error
        self.leave_out(track, source, error.reason, str(error))

    def leave_out(self, track: str, source: str, reason: RejectReason, detail: str) -> None:
        """Count a track that is left out on purpose, which is no error of the recordings."""
        self.rejected.append(Rejection(track, source, reason, detail))

    def note(self, name: str, count: int) -> None:
        """Add `count` to the counter `name`."""
        self.notes[name] = self.notes.get(name, 0) + count


@dataclass(frozen=True)
class RecordingDataset(ABC):
    """A data set on disk.

    Attributes:
        name: Name of the trajdata environment; no "-" in it.
        location: Name of the place, as trajdata wants it.
        root: Folder of the recordings.
        limits: Times, places and speeds beyond which a track is rejected.
    """

    name: ClassVar[str]
    location: ClassVar[str]

    root: Path
    limits: RecordingLimits = field(default_factory=RecordingLimits, kw_only=True)

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Origin of the recording's own frame, in the frame of the tracks."""
        return 0.0, 0.0, 0.0

    @property
    def unit_of_positions(self) -> str:
        """Unit that positions of the recordings are taken to have, for messages."""
        return "m"

    @abstractmethod
    def scenes(self) -> list[SceneSource]:
        """All scenes in a fixed order.

        Raises:
            ConversionError: If the data set is missing or incomplete.
        """

    @abstractmethod
    def read(self, scene: SceneSource, dt_s: float, *, strict: bool) -> RawScene:
        """Read one scene; `dt_s` in s is the step at which signals are tabulated.

        Raises:
            ConversionError: If the scene cannot be read, or, when `strict`, one of its tracks.
        """

    @abstractmethod
    def settings(self) -> Mapping[str, object]:
        """Plain values that change what `read` returns; hashed, and shown in the report."""

    def notes(self) -> Mapping[str, object]:
        """Facts about the whole data set for the report, such as files dropped as duplicates."""
        return {}


def fingerprint(content: bytes) -> str:
    """Hash of what a scene is made from, 16 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()[:16]


def fingerprint_of(path: Path, *, unpack: bool = False) -> str:
    """Hash of a file; one that cannot be read is told when its scene is.

    Args:
        path: The file.
        unpack: Whether that of a file that ends in ".gz" is the hash of its content.
    """
    try:
        require_plain(path)
        content = path.read_bytes()
        return fingerprint(gzip.decompress(content) if unpack and path.suffix == ".gz" else content)
    except (OSError, EOFError, zlib.error, TrackError):
        return f"unreadable {path}"


LONGEST_NAME = 120


def scene_names(keys: Iterable[str]) -> dict[str, str]:
    """Name of the scene of each key: unique, and short and plain enough for a folder.

    Args:
        keys: What the scenes are found by, as "cyclists/moving/17".

    Returns:
        Names by key; only names that would not do carry a hash of their key.
    """
    names: dict[str, str] = {}
    taken: set[str] = set()
    for key in keys:
        plain = re.sub(r"[/-]", "_", key)
        name = re.sub(r"[^A-Za-z0-9_.]", "_", plain)
        usable = name == plain and len(name.encode()) <= LONGEST_NAME and name[:1] != "."
        if not usable or name in taken:
            name = f"scene_{name[:40]}_{fingerprint(key.encode())}"
        names[key] = name
        taken.add(name)
    return names
