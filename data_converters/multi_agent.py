"""Recordings of many agents on one clock, as tables: one scene per recording."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_converters.errors import RejectReason, TrackError, fault, refuse_track, require
from data_converters.limits import SIZES, on_one_clock
from data_converters.modes import default_extent
from data_converters.recordings import (
    RawScene,
    RecordingDataset,
    SceneSource,
    fingerprint,
    fingerprint_of,
)
from data_converters.splits import RecordingSplit
from data_converters.tracks import RawTrack
from dmmv_conventions.modes import Mode

if TYPE_CHECKING:
    from trajdata.data_structures.agent import FixedExtent
LONGEST_HOLD_S = 0.5
"""For how long a heading that is missing is that of before."""

SAME_PLACE_M = 1.0
"""Distance of two samples of the same time up to which they may be of one agent."""

METRES_PER_PIXEL = (1e-4, 1.0)
"""Scales of a picture of people from above; in a coarser one they are smaller than a pixel."""


class Recording(NamedTuple):
    """One recording before it is read: its name, which is that of its scene, and its files.

    `split` is None where the recording is to be dealt, then together with all that name the same
    `group`; without one it is a group of its own.
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
        sizes: Counter[str] = Counter()
        for each in self._index.values():
            if each.split is None:
                sizes[each.group or each.name] += each.size  # type: ignore[assignment]
        dealt = self.split.deal(sizes)
        return [
            SceneSource(
                each.name,
                each.split or dealt[each.group or each.name],
                each.name,
                fingerprint(repr([self._marks[path] for path in each.files]).encode()),
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
                tables.append(_of_agents(table, source, raw, strict=strict).assign(source=source))
            except TrackError as error:
                raw.reject(path.name, source, error, strict=strict)
        tables = [table for table in tables if len(table)]
        if tables:
            table = pd.concat(tables, ignore_index=True)
            table = self._on_one_clock(table, raw, strict=strict)
            times = table["time_s"]
            start = times[np.isfinite(times)].min()
            add_tracks(raw, table.assign(time_s=times - start), strict=strict)
            for stem, side in raw.side_tables.items():
                raw.side_tables[stem] = side.assign(time_s=side["time_s"] - start)
        return raw

    def _on_one_clock(self, table: pd.DataFrame, raw: RawScene, *, strict: bool) -> pd.DataFrame:
        """Samples of the agents that share a clock; who is years away would move all others."""
        times = table["time_s"].where(np.isfinite(table["time_s"])).groupby(table["agent"])
        first, last = times.min().dropna(), times.max().dropna()
        if len(first) == 0 or last.max() - first.min() <= self.limits.span_s:
            return table
        begin, end = ({str(n): float(t) for n, t in each.items()} for each in (first, last))
        kept = on_one_clock(begin, end, self.limits.span_s)
        for name in sorted(begin.keys() - kept):
            source = str(table["source"][table["agent"] == name].iloc[0])
            needs = f"be within {self.limits.span_s:g} s of the other agents"
            remedy = "Correct the clock, or raise `span_s`."
            if end[name] - begin[name] > self.limits.span_s:
                needs = f"cover at most {self.limits.span_s:g} s for one agent"
                remedy = "Name its trips apart, or raise `span_s`."
            found = f"{begin[name]:g} to {end[name]:g} s"
            try:
                where = f"{source}, agent {name}"
                refuse_track(RejectReason.TIME_SPAN, "time_s", needs, found, where, remedy)
            except TrackError as error:
                raw.reject(name, source, error, strict=strict)
        # without a clock an agent is refused by itself
        return table[~table["agent"].isin(begin.keys() - kept)]

    def _repeats(self, path: Path, raw: RawScene) -> bool:
        """Whether a file repeats an earlier one, of another recording, say; it is counted then."""
        original = self._repeated.get(path)
        if original is not None:
            told = f"{path} repeats {original}"
            raw.leave_out(path.name, str(path), RejectReason.CONTAINED, told)
        return original is not None

    @cached_property
    def _repeated(self) -> dict[Path, Path]:
        """By file that repeats an earlier one byte by byte, the first of its kind."""
        first: dict[str, Path] = {}
        originals = {path: first.setdefault(mark, path) for path, mark in self._marks.items()}
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


def _of_agents(table: pd.DataFrame, source: str, raw: RawScene, *, strict: bool) -> pd.DataFrame:
    """Samples whose agent has a name; the others, who may be several, are counted."""
    unnamed = table["agent"].isna() if len(table) else pd.Series(dtype=bool)
    if not unnamed.any():
        return table
    found, remedy = f"none in {int(unnamed.sum())} of {len(table)} rows", "Name it in every row."
    told = fault("agent", "have a name", found, source, remedy)
    raw.reject("unnamed", source, TrackError(told, RejectReason.NO_AGENT), strict=strict)
    return table[~unnamed]


def add_tracks(raw: RawScene, table: pd.DataFrame, *, strict: bool) -> None:
    """Add every agent of a table to a scene, or count why not.

    Args:
        raw: The scene.
        table: As `MultiAgentDataset.table` returns it, time 0 being that of the scene; `source` is
            the file of a sample.
        strict: Raise at the first bad track.

    Raises:
        TrackError: When `strict`.
    """
    for name, rows in table.groupby("agent", sort=True):
        source = str(rows["source"].iloc[0])
        try:
            raw.tracks.append(_track(str(name), rows, source, raw))
        except TrackError as error:
            raw.reject(str(name), source, error, strict=strict)


def _track(name: str, rows: pd.DataFrame, source: str, raw: RawScene) -> RawTrack:
    where = f"{source}, agent {name}"
    mode = _mode(rows, where)
    needed = [column for column in ("time_s", "x", "y", "z", "id") if column in rows]
    values = rows[needed].to_numpy(np.float64)
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        needs, remedy = "be finite numbers", "Correct or remove the row."
        found = values[int(bad.argmax())]
        told = rows.iloc[int(bad.argmax())].get("fault")
        if isinstance(told, str):
            raise TrackError(told, RejectReason.NOT_FINITE)
        refuse_track(RejectReason.NOT_FINITE, ", ".join(needed), needs, found, where, remedy)
    rows = _in_order(rows, where, raw)
    height = rows["z"] if "z" in rows else np.zeros(len(rows))
    return RawTrack(
        name=name,
        mode=mode,
        time_s=rows["time_s"].to_numpy(np.float64),
        position=np.column_stack([rows["x"], rows["y"], height]).astype(np.float64),
        source=source,
        extent=_extent(rows, mode),
        speed=_optional(rows, "speed"),
        heading=_heading(rows, raw),
    )


def _in_order(rows: pd.DataFrame, where: str, raw: RawScene) -> pd.DataFrame:
    """One sample per time, the first of it, in the order of time."""
    rows = rows.sort_values("time_s", kind="stable")
    time_s, x, y = (rows[name].to_numpy(np.float64) for name in ("time_s", "x", "y"))
    fresh = np.concatenate([[True], np.diff(time_s) > 0.0])
    if len(rows) > 1 and fresh.sum() == 1:
        needs, remedy = "increase", "The agent has no clock."
        refuse_track(RejectReason.REPEATED_TIMESTAMPS, "time_s", needs, time_s[:2], where, remedy)
    first = np.maximum.accumulate(np.where(fresh, np.arange(len(rows)), 0))
    apart = np.hypot(x - x[first], y - y[first])
    if apart.max() > SAME_PLACE_M:
        needs, remedy = "be in one place at a time", "Name agents apart, or remove one of the rows."
        found = f"two {apart.max():.3g} m apart, {time_s[apart.argmax()]:g} s from the beginning"
        refuse_track(RejectReason.TWO_PLACES, "agent", needs, found, where, remedy)
    raw.note("repeated_timestamps", int((~fresh).sum()))
    return rows[fresh]


def _mode(rows: pd.DataFrame, where: str) -> Mode:
    modes = rows["mode"].unique()
    known = np.isfinite(modes)
    if len(modes) != 1 or not known.all():
        labels = sorted({str(label) for label in rows.get("label", rows["mode"])})
        needs, remedy = "be one known class for all rows of an agent", "Map it to a mode."
        if known.all():
            remedy = "Give it one class, or another name to each of several agents."
        elif "advice" in rows:
            remedy = str(rows["advice"][rows["mode"].isna()].iloc[0])
        refuse_track(RejectReason.UNKNOWN_CLASS, "type", needs, ", ".join(labels), where, remedy)
    return Mode(int(modes[0]))


def _heading(rows: pd.DataFrame, raw: RawScene) -> NDArray[np.float64] | None:
    """The recorded heading; where it is missing for a moment, the last one, which looks not ahead.

    An agent that lacks it for longer, or from the start on, is counted, and faces where it goes.
    """
    if "heading" not in rows:
        return None
    values, time_s = (rows[name].to_numpy(np.float64) for name in ("heading", "time_s"))
    known = np.isfinite(values)
    latest = np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))
    usable = known[0] and (time_s - time_s[latest]).max() <= LONGEST_HOLD_S
    raw.note("headings_held", int(usable) * int((~known).sum()))
    raw.note("agents_with_unusable_headings", int(known.any() and not usable))
    return values[latest] if usable else None


def _optional(rows: pd.DataFrame, column: str) -> NDArray[np.float64] | None:
    """A column, if every row of the agent has a finite number in it."""
    if column not in rows:
        return None
    values = rows[column].to_numpy(np.float64)
    return values if np.isfinite(values).all() else None


def _extent(rows: pd.DataFrame, mode: Mode) -> FixedExtent | None:
    """Median of the stated sizes; what is not stated is the usual one of the mode."""
    from trajdata.data_structures.agent import FixedExtent

    usual = default_extent(mode)
    stated = [float(rows[column].median()) if column in rows else float("nan") for column in SIZES]
    if not np.isfinite(stated).any():
        return None
    filled = zip(stated, (usual.length, usual.width, usual.height), strict=True)
    return FixedExtent(*(own if np.isfinite(own) else default for own, default in filled))


def modes_of(labels: pd.Series, known: Mapping[str, Mode]) -> pd.Series:
    """Mode of each label as a number, NaN where it is not known; case does not count."""
    numbers = {name.lower(): float(mode) for name, mode in known.items()}
    return labels.astype(str).str.strip().str.lower().map(numbers)
