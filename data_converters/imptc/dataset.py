"""The IMPTC sequences: all road users of a sequence on one clock."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import floor
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import pandas as pd

from data_converters.errors import RejectReason, TrackError, fault, require
from data_converters.imptc.context import read_context, signals_per_step
from data_converters.imptc.reader import (
    UTM32_OFFSET_M,
    TrackFile,
    TrackFilter,
    load_json,
    parse_track,
    refuse_missing,
    refuse_unfinished,
)
from data_converters.limits import on_one_clock
from data_converters.recordings import (
    RawScene,
    RecordingDataset,
    SceneSource,
    fingerprint,
    fingerprint_of,
)
from data_converters.tracks import RawTrack
from dmmv_conventions.cache import SPLITS
from dmmv_conventions.modes import Mode

SEQUENCE = re.compile(r"(\d{4})_(\d{8}_\d{6})")
FAMILIES = ("vrus", "vehicles")


class NumberRange(NamedTuple):
    """Sequence numbers first..last, both included."""

    first: int
    last: int


PUBLISHED_SETS = {
    "set_01": NumberRange(0, 49),
    "set_02": NumberRange(50, 99),
    "set_03": NumberRange(100, 149),
    "set_04": NumberRange(150, 199),
    "set_05": NumberRange(200, 269),
}


@dataclass(frozen=True)
class SequenceSplit:
    """Which sets go to which split.

    Attributes:
        train: Names of sets.
        val: Names of sets.
        test: Names of sets.
        exceptions: Split by sequence number, for numbers that do not follow their set, such as the
            four sample sequences.

    Raises:
        ConversionError: If a set or split is unknown, or a set stands in two splits.
    """

    train: tuple[str, ...] = ("set_01", "set_03")
    val: tuple[str, ...] = ("set_02", "set_04")
    test: tuple[str, ...] = ("set_05",)
    exceptions: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        named = [name for split in SPLITS for name in getattr(self, split)]
        fits = len(set(named)) == len(named) and set(named) <= set(PUBLISHED_SETS)
        known = f"name each of {sorted(PUBLISHED_SETS)} at most once"
        require(fits, "split", known, named, "", "Correct the lists.")
        fits = set(self.exceptions.values()) <= set(SPLITS)
        require(fits, "exceptions", f"name {SPLITS}", self.exceptions, "", "Correct them.")

    def of(self, number: int) -> str | None:
        """Split of a sequence number, None if its set is not used."""
        if number in self.exceptions:
            return self.exceptions[number]
        for split in SPLITS:
            for name in getattr(self, split):
                numbers = PUBLISHED_SETS[name]
                if numbers.first <= number <= numbers.last:
                    return split
        return None


@dataclass(frozen=True)
class ImptcDataset(RecordingDataset):
    """The IMPTC sequences below a folder, at any depth up to three.

    Attributes:
        root: Folder of the sequences or of the sets.
        split: Which sets go to which split; sequences of other sets are left out.
        keep: Which samples and tracks to keep.
    """

    name: ClassVar[str] = "imptc"
    location: ClassVar[str] = "aschaffenburg"

    split: SequenceSplit = field(default_factory=SequenceSplit)
    keep: TrackFilter = field(default_factory=TrackFilter)

    def settings(self) -> Mapping[str, object]:
        """Split and filter."""
        return {"split": asdict(self.split), "keep": asdict(self.keep)}

    def notes(self) -> Mapping[str, object]:
        """Sequence folders that are left out: repeated ones, and those of sets without a split."""
        taken = find_sequences(self.root)
        repeated = set(_sequence_folders(self.root)) - set(taken.values())
        unused = [folder for name, folder in taken.items() if self._split_of(name) is None]
        return {
            "repeated_sequences": [str(each.relative_to(self.root)) for each in sorted(repeated)],
            "unused_sequences": [str(each.relative_to(self.root)) for each in unused],
        }

    def folders(self) -> dict[str, Path]:
        """Sequence folders by name, in order.

        Raises:
            ConversionError: If there is none, or a download is not finished.
        """
        refuse_unfinished(self.root)
        found = find_sequences(self.root)
        if not found:
            refuse_missing("sequence folders NNNN_YYYYMMDD_HHMMSS", "none", self.root)
        return found

    def scenes(self) -> list[SceneSource]:
        """One scene per sequence folder.

        Raises:
            ConversionError: If no sequence folder is there, or a download is not finished.
        """
        scenes = []
        for name, folder in self.folders().items():
            split = self._split_of(name)
            if split is not None:
                key = str(folder.relative_to(self.root))
                scenes.append(SceneSource(name, split, key, _fingerprint(folder)))
        return scenes

    def read(self, scene: SceneSource, dt_s: float, *, strict: bool) -> RawScene:
        """All tracks of a sequence; time 0 is its first sample.

        Raises:
            TrackError: When `strict`, if a track cannot be used.
        """
        raw = RawScene()
        folder = self.root / scene.key
        files: dict[str, TrackFile] = {}
        for path in track_files(folder):
            try:
                files[_agent_name(path)] = self._parsed(path)
            except TrackError as error:
                source = str(path.relative_to(self.root))
                raw.reject(_agent_name(path), source, error, strict=strict)
        self._keep_one_clock(raw, files, scene.key, strict=strict)
        if not files:
            return raw
        origin = min(int(track.timestamp[0]) for track in files.values())
        for name, track in files.items():
            raw.note("samples_dropped", track.dropped)
            boxed = track.mode in (Mode.CAR, Mode.TRUCK)
            raw.note("vehicles_without_cuboids", int(boxed and track.extent is None))
            raw.tracks.append(to_raw_track(track, name, f"{scene.key}/{name}", origin))
        self._add_context(raw, folder, origin, dt_s)
        return raw

    def read_tracks(self, folder: Path) -> pd.DataFrame:
        """Samples of all usable tracks of one sequence folder, as recorded.

        Returns:
            Columns agent_id, mode, timestamp_us, x, y, z (m), speed (m/s), one row per sample.
        """
        parts = []
        for path in track_files(folder):
            try:
                track = self._parsed(path)
            except TrackError:
                continue
            table = pd.DataFrame(track.position, columns=pd.Index(("x", "y", "z")))
            table = table.assign(
                timestamp_us=track.timestamp, speed=track.speed, mode=int(track.mode)
            )
            parts.append(table.assign(agent_id=_agent_name(path)))
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Origin of the local frame: in UTM where positions are given so."""
        return UTM32_OFFSET_M if self.keep.utm else super().origin_m

    def _split_of(self, sequence: str) -> str | None:
        return self.split.of(int(sequence[:4]))

    def _parsed(self, path: Path) -> TrackFile:
        return parse_track(load_json(path), str(path), self.keep, self.limits)

    def _keep_one_clock(
        self, raw: RawScene, files: dict[str, TrackFile], key: str, *, strict: bool
    ) -> None:
        """Reject tracks whose time is far from that of the others: one clock serves them all."""
        span = self.limits.span_s
        first = {name: float(track.timestamp[0]) for name, track in files.items()}
        last = {name: float(track.timestamp[-1]) for name, track in files.items()}
        for name in sorted(set(files) - on_one_clock(first, last, span * 1e6)):
            del files[name]
            needs = f"lie within {span:g} s of the other tracks"
            found, where = f"{first[name]:.0f} µs", f"{key}/{name}"
            remedy = "Correct its clock, or remove it."
            message = fault("ts", needs, found, where, remedy)
            error = TrackError(message, RejectReason.TIME_SPAN)
            raw.reject(name, where, error, strict=strict)

    def _add_context(self, raw: RawScene, folder: Path, origin: int, dt_s: float) -> None:
        raw.side_tables, broken = read_context(folder / "context", origin)
        raw.note("broken_context_files", broken)
        lights = raw.side_tables.get("traffic_lights")
        if lights is not None:
            last = max(float(track.time_s[-1]) for track in raw.tracks)
            # as many steps as the agents have, see `resample`
            raw.signals = signals_per_step(lights, floor(last / dt_s + 1e-6) + 1, dt_s)


def sequences_at(folder: str | None) -> ImptcDataset | None:
    """The sequence release in a folder, None where there is no folder."""
    return None if folder is None else ImptcDataset(Path(folder))


def find_sequences(root: Path) -> dict[str, Path]:
    """Sequence folders up to three levels below `root`, by name, in order.

    The sample package repeats sequences of the sets under other numbers: of folders that start at
    the same time, the one below a folder named after a set is taken.
    """
    found: dict[str, Path] = {}
    folders = _sequence_folders(root)
    for path in sorted(folders, key=lambda path: (not _in_set(path, root), path.name)):
        found.setdefault(path.name.partition("_")[2], path)
    return {path.name: path for path in sorted(found.values(), key=lambda path: path.name)}


def _sequence_folders(root: Path) -> list[Path]:
    paths = (path for pattern in ("*", "*/*", "*/*/*") for path in root.glob(pattern))
    return [path for path in paths if SEQUENCE.fullmatch(path.name) and path.is_dir()]


def _in_set(path: Path, root: Path) -> bool:
    return "set_" in str(path.parent.relative_to(root))


def track_files(folder: Path) -> list[Path]:
    """The track file of each folder of a sequence, absent or not; either family may be absent."""
    folders = [place for family in FAMILIES for place in sorted((folder / family).glob("*"))]
    return [place / "track.json" for place in folders if place.is_dir()]


def to_raw_track(track: TrackFile, name: str, source: str, origin_us: int) -> RawTrack:
    """A track on the clock of its scene, whose time 0 is `origin_us` in microseconds."""
    return RawTrack(
        name=name,
        mode=track.mode,
        time_s=(track.timestamp - origin_us).astype(np.float64) / 1e6,
        position=track.position,
        source=source,
        extent=track.extent,
        axis=track.axis,
        speed=track.speed if np.isfinite(track.speed).any() else None,
    )


def _agent_name(path: Path) -> str:
    """Family and number of a track file: "vru_007" for vrus/007/track.json."""
    return f"{path.parent.parent.name[:-1]}_{path.parent.name}"


def _fingerprint(folder: Path) -> str:
    files = [*track_files(folder), *sorted((folder / "context").glob("*.json"))]
    marks = [(str(path.relative_to(folder)), fingerprint_of(path)) for path in files]
    return fingerprint(repr(marks).encode())
