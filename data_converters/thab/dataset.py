"""TH-AB VRU tracks as scenes: one file, one track, one scene; split by recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.errors import RejectReason, TrackError
from data_converters.recordings import (
    RawScene,
    RecordingDataset,
    SceneSource,
    fingerprint,
    scene_names,
)
from data_converters.splits import RecordingSplit
from data_converters.thab.duplicates import find_contained, group_recordings
from data_converters.thab.modes import FOLDER_MODES
from data_converters.thab.reader import ThabFile, parse, read_files
from data_converters.tracks import RawTrack
from dmmv_conventions.cache import SPLITS
from dmmv_conventions.modes import Mode


class _Index(NamedTuple):
    """All files: content, faults, what contains what, and the group and split of each."""

    samples: dict[str, NDArray[np.float64]]
    modes: dict[str, Mode]
    faults: dict[str, TrackError]
    contained: dict[str, str]
    groups: dict[str, str]
    splits: dict[str, str]


@dataclass(frozen=True)
class ThabVruDataset(RecordingDataset):
    """The TH-AB VRU tracks, from the archives or from the folders they unpack to.

    A file whose samples are all part of another one is dropped. Files that name the same recording
    or share samples form a group; groups are ordered by a hash of their name and dealt out, per
    class, so that train, val and test get their share of the tracks.

    Attributes:
        root: Folder with cyclists and pedestrians (`.tar.gz` or folders).
        shares: Share of the tracks in train, val and test.
        salt: Changes the order of the groups, hence the split.

    Raises:
        ConversionError: If the shares are negative or do not add up to 1.
    """

    name: ClassVar[str] = "thab_vru"
    location: ClassVar[str] = "aschaffenburg"

    shares: tuple[float, float, float] = (0.70, 0.15, 0.15)
    salt: str = ""

    def __post_init__(self) -> None:
        RecordingSplit(self.shares, self.salt)

    def settings(self) -> Mapping[str, object]:
        """Shares and salt of the split."""
        return {"shares": list(self.shares), "salt": self.salt}

    def notes(self) -> Mapping[str, object]:
        """Contained files and number of recording groups per class."""
        groups = {(self._index.modes[name], group) for name, group in self._index.groups.items()}
        return {
            "contained": dict(sorted(self._index.contained.items())),
            "recording_groups": dict(Counter(mode.label for mode, _ in groups)),
        }

    def scenes(self) -> list[SceneSource]:
        """One scene per file, also for files that are rejected later, so that they are counted.

        Raises:
            ConversionError: If the data set is missing or an archive is broken.
        """
        names = scene_names(path.removesuffix(".csv") for path in self._index.modes)
        return [
            SceneSource(
                names[path.removesuffix(".csv")],
                self._index.splits[path],
                path,
                self._fingerprint(path),
                self._index.groups.get(path, ""),
            )
            for path in self._index.modes
        ]

    def read(self, scene: SceneSource, dt_s: float, *, strict: bool) -> RawScene:
        """The track of one file, (n, 3) m with z = 0.

        Raises:
            TrackError: When `strict`, if the file cannot be used; being contained is no error.
        """
        raw = RawScene()
        path, index = scene.key, self._index
        if path in index.faults:
            raw.reject("track", path, index.faults[path], strict=strict)
            return raw
        if path in index.contained:
            message = f"all samples of {path} are part of {index.contained[path]}"
            raw.leave_out("track", path, RejectReason.CONTAINED, message)
            return raw
        samples = index.samples[path]
        samples = samples[np.argsort(samples[:, 0], kind="stable")]
        fresh = np.concatenate([[True], np.diff(samples[:, 0]) > 0.0])
        raw.note("repeated_timestamps", int((~fresh).sum()))
        samples = samples[fresh]
        position = np.column_stack([samples[:, 1:], np.zeros(len(samples))])
        time_s = samples[:, 0] - samples[0, 0]
        raw.tracks.append(RawTrack("track", index.modes[path], time_s, position, path))
        return raw

    @cached_property
    def _index(self) -> _Index:
        files = read_files(self.root)
        modes = {file.path: FOLDER_MODES[file.group] for file in files}
        samples: dict[str, NDArray[np.float64]] = {}
        faults: dict[str, TrackError] = {}
        for file in files:
            try:
                samples[file.path] = parse(file, self.limits)
            except TrackError as error:
                faults[file.path] = error
        positions = {path: values[:, 1:] for path, values in samples.items()}
        contained = find_contained(positions)
        groups = group_recordings(positions, _recordings(files, samples))
        splits = dict.fromkeys(modes, SPLITS[0])
        kept = [path for path in samples if path not in contained]
        split = RecordingSplit(self.shares, self.salt)
        for mode in FOLDER_MODES.values():
            of_mode = {path: groups[path] for path in kept if modes[path] is mode}
            split_of_group = split.deal(Counter(of_mode.values()))
            splits |= {p: split_of_group[g] for p, g in groups.items() if g in split_of_group}
        return _Index(samples, modes, faults, contained, groups, splits)

    def _fingerprint(self, path: str) -> str:
        index = self._index
        if path in index.faults:
            # the same wherever the folder lies
            return fingerprint(str(index.faults[path]).replace(str(self.root), "").encode())
        return fingerprint(index.samples[path].tobytes() + index.contained.get(path, "").encode())


def _recordings(files: list[ThabFile], samples: Mapping[str, object]) -> dict[str, str]:
    """By path the recording its name states.

    "1008_27" is track 27 of recording 1008. A name that is another one of its class with "1000" in
    front was cut out of that recording.
    """
    stems = {(file.group, file.stem.split("_")[0]) for file in files}
    named: dict[str, str] = {}
    for file in files:
        base = file.stem.split("_")[0]
        if base.startswith("1000") and (file.group, base[4:]) in stems:
            base = base[4:]
        if file.path in samples:
            named[file.path] = f"{file.group}/{base}"
    return named
