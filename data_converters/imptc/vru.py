"""The IMPTC VRU-trajectory release: single tracks, split as published."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from data_converters.errors import RejectReason, TrackError, require
from data_converters.imptc.dataset import ImptcDataset, find_sequences, size_of, to_raw_track
from data_converters.imptc.reader import (
    UTM32_OFFSET_M,
    TrackFilter,
    load_json,
    parse_track,
    refuse_missing,
    refuse_unfinished,
)
from data_converters.recordings import (
    RawScene,
    RecordingDataset,
    SceneSource,
    fingerprint,
    scene_names,
)

RELEASE_SPLITS = {"train": "train", "eval": "val", "test": "test"}
"""Folder of the release and its split."""


class Overlap(NamedTuple):
    """A track of the VRU release whose sequence stands in the sequence release, and both splits."""

    track: str
    source: str
    sequence: str
    vru_split: str
    sequence_split: str


@dataclass(frozen=True)
class ImptcVruDataset(RecordingDataset):
    """The VRU-trajectory release; every track is a scene of its own.

    The release is cut from sequences, of which many are in the sequence release as well. Give these
    as `sequences` to leave out every track whose sequence stands in another split there, so that
    nothing is trained on in one release and tested on in the other.

    Attributes:
        root: Folder with train, eval and test, or with their `_tracks.json` files.
        keep: Which samples and tracks to keep.
        sequences: The sequence release to agree with, None to take the published split as it is.
    """

    name: ClassVar[str] = "imptc_vru"
    location: ClassVar[str] = "aschaffenburg"

    keep: TrackFilter = field(default_factory=TrackFilter)
    sequences: ImptcDataset | None = None

    def settings(self) -> Mapping[str, object]:
        """Filter, and the split of the sequences where they are given."""
        split = None if self.sequences is None else asdict(self.sequences.split)
        return {"keep": asdict(self.keep), "agrees_with_sequences": split}

    def notes(self) -> Mapping[str, object]:
        """Tracks that stand in another split of the sequence release."""
        return {
            "overlaps_in_other_split": [overlap._asdict() for overlap in self._conflicts.values()]
        }

    def scenes(self) -> list[SceneSource]:
        """One scene per track, named split_NNNN.

        Raises:
            ConversionError: If a split is missing, its combined file is broken, or a download is
                not finished.
        """
        refuse_unfinished(self.root)
        absent = [name for name in RELEASE_SPLITS if not _present(self._base, name)]
        if absent:
            refuse_missing("train, eval and test of the VRU release", f"no {absent}", self.root)
        marks = {
            (name, f"{name}/{track}"): mark
            for name in RELEASE_SPLITS
            for track, mark in self._tracks(name)
        }
        names = scene_names(key for _, key in marks)
        scenes = []
        for (name, key), mark in marks.items():
            agrees = "" if key not in self._conflicts else "other_split"
            scenes.append(SceneSource(names[key], RELEASE_SPLITS[name], key, mark + agrees))
        return scenes

    def read(self, scene: SceneSource, dt_s: float, *, strict: bool) -> RawScene:
        """The one track of a scene; time 0 is its first sample.

        Raises:
            TrackError: When `strict`, if the track cannot be used; standing in another split of the
                sequence release is never an error.
        """
        raw = RawScene()
        conflict = self._conflicts.get(scene.key)
        if conflict is not None:
            message = f"{conflict.source} is in {conflict.sequence_split} of the sequence release"
            raw.leave_out("vru", scene.key, RejectReason.OTHER_SPLIT, message)
            return raw
        path = self._base / scene.key / "track.json"
        try:
            content = self._content(scene.key, path)
            track = parse_track(content, str(path), self.keep, self.limits)
        except TrackError as error:
            raw.reject("vru", scene.key, error, strict=strict)
            return raw
        raw.note("samples_dropped", track.dropped)
        raw.tracks.append(to_raw_track(track, "vru", scene.key, int(track.timestamp[0])))
        return raw

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Origin of the local frame: in UTM where positions are given so."""
        return UTM32_OFFSET_M if self.keep.utm else super().origin_m

    def overlaps(self, sequences: ImptcDataset) -> list[Overlap]:
        """Tracks whose sequence is part of the sequence release, joined by `src_info.txt`."""
        known = {name.partition("_")[2]: name for name in find_sequences(sequences.root)}
        found = []
        for folder, split in RELEASE_SPLITS.items():
            for path in sorted((self._base / folder).glob("*/src_info.txt")):
                source = _first_line(path)
                sequence = known.get(source.partition("/")[0])
                other = sequences.split.of(int(sequence[:4])) if sequence else None
                if sequence and other:
                    key = f"{folder}/{path.parent.name}"
                    found.append(Overlap(key, source, sequence, split, other))
        return found

    @cached_property
    def _base(self) -> Path:
        """Folder of the splits: the root or one up to two levels below it."""
        places = [self.root, *sorted(self.root.glob("*")), *sorted(self.root.glob("*/*"))]
        return next((place for place in places if _present(place, "train")), self.root)

    @cached_property
    def _conflicts(self) -> dict[str, Overlap]:
        overlaps = self.overlaps(self.sequences) if self.sequences is not None else []
        return {o.track: o for o in overlaps if o.vru_split != o.sequence_split}

    def _tracks(self, folder: str) -> list[tuple[str, str]]:
        """Names and fingerprints of the tracks of a split."""
        if (self._base / folder).is_dir():
            places = [path for path in sorted((self._base / folder).glob("*")) if path.is_dir()]
            return [(place.name, str(size_of(place / "track.json"))) for place in places]
        return [
            (name, _digest(content)) for name, content in sorted(self._combined[folder].items())
        ]

    def _content(self, key: str, path: Path) -> Any:
        folder, _, name = key.partition("/")
        unpacked = (self._base / folder).is_dir()
        return load_json(path) if unpacked else self._combined[folder][name]

    @cached_property
    def _combined(self) -> dict[str, dict[str, Any]]:
        paths = {name: self._base / f"{name}_tracks.json" for name in RELEASE_SPLITS}
        content = {name: load_json(path) for name, path in paths.items() if path.is_file()}
        for name, tracks in content.items():
            needs, remedy = "hold tracks by name", "Unpack the archive again."
            known, found = isinstance(tracks, dict), type(tracks).__name__
            require(known, "file", needs, found, paths[name], remedy)
        return content


def _present(base: Path, name: str) -> bool:
    return (base / name).is_dir() or (base / f"{name}_tracks.json").is_file()


def _first_line(path: Path) -> str:
    """Content of a small text file, "" where there is none."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip().strip('"')
    except OSError:
        return ""


def _digest(content: object) -> str:
    return fingerprint(repr(content).encode())
