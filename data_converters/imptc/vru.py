"""The IMPTC VRU-trajectory release: tracks that overlap in time are scenes, split by recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from data_converters.errors import RejectReason, TrackError, require
from data_converters.imptc.dataset import ImptcDataset, find_sequences, size_of, to_raw_track
from data_converters.imptc.reader import (
    UTM32_OFFSET_M,
    TrackFilter,
    load_json,
    parse_track,
    refuse_missing,
    refuse_unfinished,
    time_span_us,
)
from data_converters.plain_files import require_plain
from data_converters.recordings import (
    RawScene,
    RecordingDataset,
    SceneSource,
    fingerprint,
    scene_names,
)
from data_converters.splits import RecordingSplit

RELEASE_SPLITS = {"train": "train", "eval": "val", "test": "test"}
"""Folder of the release and its split."""

PAUSE_US = 30_000_000
"""Tracks with shorter pauses between them are of one recording."""

LONGEST_US = 3_600_000_000
"""A track that claims to last longer has a broken clock, and joins nothing."""


class Overlap(NamedTuple):
    """A track of the VRU release whose sequence stands in the sequence release, and both splits."""

    track: str
    source: str
    sequence: str
    vru_split: str
    sequence_split: str


class _VruTrack(NamedTuple):
    """One track of the release: its folder and name, sequence ("" if not told) and time in µs."""

    key: str
    mark: str
    sequence: str
    first_us: int
    last_us: int


class _VruScene(NamedTuple):
    """Tracks that overlap in time, and the split of their recording."""

    name: str
    split: str
    tracks: tuple[_VruTrack, ...]


@dataclass(frozen=True)
class ImptcVruDataset(RecordingDataset):
    """The VRU-trajectory release: tracks on one clock (UTC), joined where they overlap in time.

    The release deals the tracks of a sequence to different splits. A recording (tracks of one
    sequence by `src_info.txt`, or with pauses of less than 30 s) stays in one here: the published
    split if all its tracks share it, else whole recordings are dealt by a hash of their names, or
    take the split of their sequence in `sequences`.

    The release is cut from sequences, of which many are in the sequence release as well. Give these
    as `sequences` to leave out every track whose sequence stands in another split there, so that
    nothing is trained on in one release and tested on in the other.

    Attributes:
        root: Folder with train, eval and test, or with their `_tracks.json` files.
        keep: Which samples and tracks to keep.
        sequences: The sequence release to agree with, None to take the split as it is.
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
        """One scene per group of tracks that overlap in time, named after its first track.

        Raises:
            ConversionError: If a split is missing, its combined file is broken, or a download is
                not finished.
        """
        refuse_unfinished(self.root)
        absent = [name for name in RELEASE_SPLITS if not _present(self._base, name)]
        if absent:
            refuse_missing("train, eval and test of the VRU release", f"no {absent}", self.root)
        scenes = []
        for scene in self._scenes.values():
            marks = [[t.key, t.mark, t.key in self._conflicts] for t in scene.tracks]
            mark = fingerprint(repr(marks).encode())
            scenes.append(SceneSource(scene.name, scene.split, scene.name, mark))
        return scenes

    def read(self, scene: SceneSource, dt_s: float, *, strict: bool) -> RawScene:
        """The tracks of a scene; time 0 is the first sample of them.

        Raises:
            TrackError: When `strict`, if a track cannot be used; standing in another split of the
                sequence release is never an error.
        """
        raw, files = RawScene(), {}
        for key in [track.key for track in self._scenes[scene.key].tracks]:
            agent = _agent_name(key)
            conflict = self._conflicts.get(key)
            if conflict is not None:
                message = f"{conflict.source} is in {conflict.sequence_split} of the other release"
                raw.leave_out(agent, key, RejectReason.OTHER_SPLIT, message)
                continue
            path = self._path(key)
            try:
                files[key] = parse_track(self._content(key), str(path), self.keep, self.limits)
            except TrackError as error:
                raw.reject(agent, key, error, strict=strict)
                continue
            moved = RELEASE_SPLITS[key.partition("/")[0]] != scene.split
            raw.note("tracks_of_another_published_split", int(moved))
            raw.note("samples_dropped", files[key].dropped)
        origin = min((int(track.timestamp[0]) for track in files.values()), default=0)
        for key, track in files.items():
            raw.tracks.append(to_raw_track(track, _agent_name(key), key, origin))
        return raw

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Origin of the local frame: in UTM where positions are given so."""
        return UTM32_OFFSET_M if self.keep.utm else super().origin_m

    def overlaps(self, sequences: ImptcDataset) -> list[Overlap]:
        """Tracks whose sequence is part of the sequence release, joined by `src_info.txt`."""
        known = {name.partition("_")[2]: name for name in find_sequences(sequences.root)}
        found = []
        for scene in self._scenes.values():
            for track in scene.tracks:
                sequence = known.get(track.sequence)
                other = sequences.split.of(int(sequence[:4])) if sequence else None
                if sequence and other:
                    source = self._source(track.key)
                    found.append(Overlap(track.key, source, sequence, scene.split, other))
        return sorted(found)

    def _known_splits(self) -> dict[str, str]:
        """By its start the split of each sequence of the other release."""
        if self.sequences is None:
            return {}
        splits = {
            name.partition("_")[2]: self.sequences.split.of(int(name[:4]))
            for name in find_sequences(self.sequences.root)
        }
        return {start: split for start, split in splits.items() if split is not None}

    @cached_property
    def _scenes(self) -> dict[str, _VruScene]:
        """By name all scenes, in the order of the release."""
        tracks = [track for folder in RELEASE_SPLITS for track in self._tracks(folder)]
        together = _overlapping(tracks, pause_us=0)
        recordings = _connected(
            _overlapping(tracks, pause_us=PAUSE_US), [track.sequence for track in tracks]
        )
        splits = _splits(recordings, tracks, self._known_splits())
        grouped: dict[int, list[int]] = {}
        for number, group in enumerate(together):
            grouped.setdefault(group, []).append(number)
        chosen = {
            tracks[members[0]].key: tuple(tracks[number] for number in members)
            for members in grouped.values()
        }
        split = {track.key: splits[recordings[n]] for n, track in enumerate(tracks)}
        names = scene_names(chosen)
        return {
            names[key]: _VruScene(names[key], split[key], together)
            for key, together in chosen.items()
        }

    @cached_property
    def _base(self) -> Path:
        """Folder of the splits: the root or one up to two levels below it."""
        places = [self.root, *sorted(self.root.glob("*")), *sorted(self.root.glob("*/*"))]
        return next((place for place in places if _present(place, "train")), self.root)

    @cached_property
    def _conflicts(self) -> dict[str, Overlap]:
        overlaps = self.overlaps(self.sequences) if self.sequences is not None else []
        return {o.track: o for o in overlaps if o.vru_split != o.sequence_split}

    def _tracks(self, folder: str) -> list[_VruTrack]:
        """Tracks of a published split; one that cannot be read has no time, and joins nothing."""
        if (self._base / folder).is_dir():
            places = [path for path in sorted((self._base / folder).glob("*")) if path.is_dir()]
            named = {place.name: str(size_of(place / "track.json")) for place in places}
        else:
            named = {k: _digest(content) for k, content in sorted(self._combined[folder].items())}
        return [self._track(f"{folder}/{name}", mark) for name, mark in named.items()]

    def _track(self, key: str, mark: str) -> _VruTrack:
        try:
            first, last = time_span_us(self._content(key), str(self._path(key)))
        except TrackError:
            first, last = 0, -1
        return _VruTrack(key, mark, self._source(key).partition("/")[0], first, last)

    def _source(self, key: str) -> str:
        """Sequence and number of a track there, "" where `src_info.txt` is absent."""
        return _first_line(self._base / key / "src_info.txt")

    def _path(self, key: str) -> Path:
        return self._base / key / "track.json"

    def _content(self, key: str) -> Any:
        folder, _, name = key.partition("/")
        unpacked = (self._base / folder).is_dir()
        return load_json(self._path(key)) if unpacked else self._combined[folder][name]

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
        require_plain(path)
        return path.read_text(encoding="utf-8", errors="replace").strip().strip('"')
    except (OSError, TrackError):
        return ""


def _digest(content: object) -> str:
    return fingerprint(repr(content).encode())


def _agent_name(key: str) -> str:
    return key.replace("/", "_")


def _overlapping(tracks: list[_VruTrack], *, pause_us: int) -> list[int]:
    """Group of each track, the number of one of its tracks: groups are `pause_us` apart in time.

    A track without a usable time is a group of its own.
    """
    groups = list(range(len(tracks)))
    timed = [n for n, t in enumerate(tracks) if 0 <= t.last_us - t.first_us <= LONGEST_US]
    group, until = -1, -math.inf
    for number in sorted(timed, key=lambda number: tracks[number].first_us):
        if tracks[number].first_us > until + pause_us:
            group = number
        groups[number] = group
        until = max(until, tracks[number].last_us)
    return groups


def _connected(groups: list[int], sequences: list[str]) -> list[int]:
    """Groups joined where they hold tracks of one sequence; "" is none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(groups)
    named = {sequence: number for number, sequence in enumerate(dict.fromkeys(sequences), count)}
    links = [(g, named[s]) for g, s in zip(groups, sequences, strict=True) if s]
    ends = np.array(links, dtype=np.int64).reshape(-1, 2)
    size = count + len(named)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(size, size))
    labels = connected_components(graph, directed=False)[1]
    return [int(labels[group]) for group in groups]


def _splits(
    recordings: list[int], tracks: list[_VruTrack], known: Mapping[str, str]
) -> dict[int, str]:
    """Split of each recording: the published one if its tracks share it, else that of its sequence.

    `known` are the splits of sequences in the other release; the rest is dealt.
    """
    published: dict[int, list[str]] = {}
    first: dict[int, _VruTrack] = {}
    for recording, track in zip(recordings, tracks, strict=True):
        published.setdefault(recording, []).append(RELEASE_SPLITS[track.key.partition("/")[0]])
        first.setdefault(recording, track)
    mixed = {r: float(len(splits)) for r, splits in published.items() if len(set(splits)) > 1}
    dealt = RecordingSplit().deal({first[r].key: size for r, size in mixed.items()})
    return {r: splits[0] for r, splits in published.items()} | {
        r: known.get(first[r].sequence, dealt[first[r].key]) for r in mixed
    }
