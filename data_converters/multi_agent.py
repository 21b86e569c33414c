"""Recordings of many agents on one clock, as tables: one scene per recording."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import pandas as pd

from data_converters.agent_tables import add_tracks, named_agents, on_shared_clock
from data_converters.errors import RejectReason, TrackError, refuse_track, require
from data_converters.recordings import (
    RawScene,
    RecordingDataset,
    SceneSource,
    fingerprint,
    fingerprint_of,
)
from data_converters.splits import RecordingSplit
from dmmv_conventions.modes import Mode

METRES_PER_PIXEL = (1e-4, 1.0)
"""Scales of a picture of people from above; in a coarser one they are smaller than a pixel."""


class Recording(NamedTuple):
    """One recording before it is read: its name, which is that of its scene, and its files.

    `split` is None where the recording is to be dealt, then together with all that name the same
    `group`, of which they are parts; without one it is a group of its own.
    """

    name: str
    files: tuple[Path, ...]
    split: str | None = None
    group: str = ""

    @property
    def size(self) -> float:
        """Bytes of its files, a measure of how much they hold."""
        return float(sum(path.stat().st_size for path in self.files if path.is_file()))


@dataclass(frozen=True)
class MultiAgentDataset(RecordingDataset):
    """Recordings that are tables of samples; a subclass finds and reads them.

    All agents of a recording are in one scene, so that they are neighbors of each other.

    Attributes:
        root: Folder of the recordings.
        split: How whole recordings are dealt to the splits.
    """

    expects: ClassVar[str]
    """What `root` must hold, for messages."""

    split: RecordingSplit = field(default_factory=RecordingSplit)

    @abstractmethod
    def recordings(self) -> list[Recording]:
        """All recordings in a fixed order; none if the data set is not there."""

    @abstractmethod
    def table(self, path: Path, recording: Recording, raw: RawScene) -> pd.DataFrame:
        """Samples of one file of a recording, in any order.

        Tables that are to stand beside the scene go to `raw.side_tables`, on the same clock.

        Returns:
            Columns agent (name, NaN where there is none), mode (number of a `Mode`, NaN where the
            class is not known), time_s (s, on the clock that all files of the recording share),
            x, y (m, x east, y north); optionally z (m), speed (m/s), heading (rad), label (of the
            class, for messages), advice (text: what to do where the class is not known), id (number
            of the agent, which must be one) and `SIZES` (m), whose median over an agent is its
            size, and fault (text where a row cannot be read).

        Raises:
            TrackError: If the file cannot be used.
        """

    def settings(self) -> Mapping[str, object]:
        """The split."""
        return {"split": self.split.settings()}

    def scenes(self) -> list[SceneSource]:
        """One scene per recording.

        Raises:
            ConversionError: If there is no recording, or the split names one that is not there.
        """
        found = "no such folder" if not self.root.is_dir() else "nothing of the kind"
        remedy = "Give data.root=FOLDER."
        require(bool(self._index), "root", f"hold {self.expects}", found, self.root, remedy)
        sizes: dict[str, float] = {}
        for each in self._index.values():
            if each.split is None:
                group = each.group or each.name
                sizes[group] = sizes.get(group, 0.0) + each.size
        dealt = self.split.deal(sizes)
        return [
            SceneSource(
                each.name,
                each.split or dealt[each.group or each.name],
                each.name,
                fingerprint(repr([self._marks[path] for path in each.files]).encode()),
                each.group,
            )
            for each in self._index.values()
        ]

    def read(self, scene: SceneSource, dt_s: float, *, strict: bool) -> RawScene:
        """All agents of a recording; time 0 is its first sample.

        Raises:
            TrackError: When `strict`, if a file or a track cannot be used.
        """
        raw, tables = RawScene(), []
        recording = self._index[scene.key]
        for path in recording.files:
            source = str(path.relative_to(self.root))
            refused = len(raw.rejected)
            try:
                table = self.table(path, recording, raw)
                if len(table) == 0 and len(raw.rejected) == refused:
                    needs, remedy = "hold a sample", "Copy the file again, or remove it."
                    refuse_track(RejectReason.TOO_SHORT, "file", needs, "none", path, remedy)
                tables.append(named_agents(table, source, raw, strict=strict).assign(source=source))
            except TrackError as error:
                raw.reject(path.name, source, error, strict=strict)
        tables = [table for table in tables if len(table)]
        if tables:
            table = pd.concat(tables, ignore_index=True)
            table = on_shared_clock(table, self.limits.span_s, raw, strict=strict)
            times = table["time_s"]
            start = times[np.isfinite(times)].min()
            add_tracks(raw, table.assign(time_s=times - start), strict=strict)
            for stem, side in raw.side_tables.items():
                raw.side_tables[stem] = side.assign(time_s=side["time_s"] - start)
        return raw

    def _repeats(self, path: Path, raw: RawScene) -> bool:
        """Whether a file repeats an earlier one, of another recording, say; it is counted then."""
        original = self._repeated.get(path)
        if original is not None:
            told = f"{path} repeats {original}"
            raw.leave_out(path.name, str(path), RejectReason.CONTAINED, told)
        return original is not None

    @cached_property
    def _repeated(self) -> dict[Path, Path]:
        """By file that repeats an earlier one byte by byte, packed or not, the first."""
        first: dict[str, Path] = {}
        marks = self._marks | {
            path: fingerprint_of(path, unpack=True) for path in self._marks if path.suffix == ".gz"
        }
        originals = {path: first.setdefault(mark, path) for path, mark in marks.items()}
        return {path: original for path, original in originals.items() if path != original}

    @cached_property
    def _marks(self) -> dict[Path, str]:
        """Hash of each file, which may hold many scenes."""
        return {path: fingerprint_of(path) for path in self._read_files()}

    def _read_files(self) -> Iterable[Path]:
        return (path for each in self._index.values() for path in each.files)

    @cached_property
    def _index(self) -> dict[str, Recording]:
        return {recording.name: recording for recording in self.recordings()}


def by_name(files: Iterable[tuple[str, Path]]) -> dict[str, Path]:
    """Files by their names, of which none may take the place of another in silence.

    Raises:
        ConversionError: Two have one name, such as those of 1.csv and 1.csv.gz.
    """
    named: dict[str, Path] = {}
    for name, path in files:
        other = named.setdefault(name, path)
        needs = f"not name recording '{name}' as {other} does"
        remedy = "Remove or rename one of them."
        require(other == path, "file", needs, path.name, path.parent, remedy)
    return named


def agent_names(kind: str, numbers: pd.Series) -> list[str]:
    """Names of agents, such as "ped_7", for numbers of shape (R,): other numbers, other names."""
    return [f"{kind}_{number:.15g}" for number in numbers]


def modes_of(labels: pd.Series, known: Mapping[str, Mode]) -> pd.Series:
    """Mode of each label as a number, NaN where it is not known; case does not count."""
    numbers = {name.lower(): float(mode) for name, mode in known.items()}
    return labels.astype(str).str.strip().str.lower().map(numbers)
