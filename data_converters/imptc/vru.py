"""The IMPTC VRU-trajectory release: tracks that overlap in time are scenes, split by recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import ClassVar, NamedTuple

from data_converters.errors import RejectReason, TrackError, require
from data_converters.imptc.dataset import ImptcDataset, to_raw_track
from data_converters.imptc.reader import (
    UTM32_OFFSET_M,
    TrackFilter,
    parse_track,
    refuse_missing,
    refuse_unfinished,
)
from data_converters.imptc.vru_recordings import PAUSE_US, connected, overlapping, recording_splits
from data_converters.imptc.vru_release import RELEASE_SPLITS, VruRelease, VruTrack
from data_converters.recordings import (
    RawScene,
    RecordingDataset,
    SceneSource,
    fingerprint,
    scene_names,
)


class Overlap(NamedTuple):
    """A track of the VRU release whose sequence stands in the sequence release, and both splits."""

    track: str
    source: str
    sequence: str
    vru_split: str
    sequence_split: str


class _VruScene(NamedTuple):
    """Tracks that overlap in time, and their recording, named after its first scene."""

    name: str
    split: str
    tracks: tuple[VruTrack, ...]
    recording: str


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
            ConversionError: If a split is missing, its combined file is broken, a download is not
                finished, or the other release is not where it should be, or nothing tells which
                sequence a track is from.
        """
        refuse_unfinished(self.root)
        absent = self._release.absent()
        if absent:
            refuse_missing("train, eval and test of the VRU release", f"no {absent}", self.root)
        tracks = [track for scene in self._scenes.values() for track in scene.tracks]
        told = self.sequences is None or any(track.sequence for track in tracks)
        needs = "tell the sequence of a track, by which both releases are compared"
        remedy = "Unpack the folders of the tracks, or leave out `other_release`."
        require(told, "src_info.txt", needs, "none", self.root, remedy)
        scenes = []
        for scene in self._scenes.values():
            marks = [[t.key, t.mark, t.key in self._conflicts] for t in scene.tracks]
            mark = fingerprint(repr(marks).encode())
            scenes.append(SceneSource(scene.name, scene.split, scene.name, mark, scene.recording))
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
            path = self._release.path(key)
            try:
                files[key] = parse_track(
                    self._release.content(key), str(path), self.keep, self.limits
                )
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
        known = {name.partition("_")[2]: name for name in sequences.folders()}
        found = []
        for scene in self._scenes.values():
            for track in scene.tracks:
                sequence = known.get(track.sequence)
                other = sequences.split.of(int(sequence[:4])) if sequence else None
                if sequence and other:
                    source = self._release.source(track.key)
                    found.append(Overlap(track.key, source, sequence, scene.split, other))
        return sorted(found)

    def _known_splits(self) -> dict[str, str]:
        """By its start the split of each sequence of the other release."""
        if self.sequences is None:
            return {}
        splits = {
            name.partition("_")[2]: self.sequences.split.of(int(name[:4]))
            for name in self.sequences.folders()
        }
        return {start: split for start, split in splits.items() if split is not None}

    @cached_property
    def _release(self) -> VruRelease:
        return VruRelease(self.root)

    @cached_property
    def _scenes(self) -> dict[str, _VruScene]:
        """By name all scenes, in the order of the release."""
        tracks = self._release.tracks()
        together = overlapping(tracks, pause_us=0)
        recordings = connected(
            overlapping(tracks, pause_us=PAUSE_US), [track.sequence for track in tracks]
        )
        splits = recording_splits(recordings, tracks, self._known_splits())
        grouped: dict[int, list[int]] = {}
        for number, group in enumerate(together):
            grouped.setdefault(group, []).append(number)
        chosen = {
            tracks[members[0]].key: tuple(tracks[number] for number in members)
            for members in grouped.values()
        }
        recording = {track.key: recordings[n] for n, track in enumerate(tracks)}
        names = scene_names(chosen)
        first = {recording[key]: names[key] for key in reversed(chosen)}
        return {
            names[key]: _VruScene(
                names[key], splits[recording[key]], together, first[recording[key]]
            )
            for key, together in chosen.items()
        }

    @cached_property
    def _conflicts(self) -> dict[str, Overlap]:
        overlaps = self.overlaps(self.sequences) if self.sequences is not None else []
        return {o.track: o for o in overlaps if o.vru_split != o.sequence_split}


def _agent_name(key: str) -> str:
    return key.replace("/", "_")
