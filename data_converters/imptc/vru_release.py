"""The files of the IMPTC VRU-trajectory release: folders of tracks, or one file per split."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from data_converters.errors import TrackError, require
from data_converters.imptc.reader import load_json, time_span_us
from data_converters.plain_files import require_plain
from data_converters.recordings import fingerprint, fingerprint_of

RELEASE_SPLITS = {"train": "train", "eval": "val", "test": "test"}
"""Folder of the release and its split."""


class VruTrack(NamedTuple):
    """One track of the release: its folder and name, sequence ("" if not told) and time in µs."""

    key: str
    mark: str
    sequence: str
    first_us: int
    last_us: int


@dataclass(frozen=True)
class VruRelease:
    """The release in a folder; a track is named by the folder of its split and its own, "eval/7".

    Attributes:
        root: Folder with train, eval and test, or with their `_tracks.json` files, or one up to two
            levels above it.
    """

    root: Path

    def absent(self) -> list[str]:
        """Folders of published splits that are not there."""
        return [name for name in RELEASE_SPLITS if not _present(self._base, name)]

    def tracks(self) -> list[VruTrack]:
        """All tracks; one that cannot be read has no time, and joins nothing.

        Raises:
            ConversionError: A combined file is broken.
        """
        return [track for folder in RELEASE_SPLITS for track in self._tracks(folder)]

    def source(self, key: str) -> str:
        """Sequence and number of a track there, "" where `src_info.txt` is absent."""
        return _first_line(self._base / key / "src_info.txt")

    def path(self, key: str) -> Path:
        """File of a track, also where it stands in a combined one."""
        return self._base / key / "track.json"

    def content(self, key: str) -> Any:
        """What the file of a track holds.

        Raises:
            TrackError: It cannot be read.
        """
        folder, _, name = key.partition("/")
        combined = self._combined.get(folder)
        return load_json(self.path(key)) if combined is None else combined[name]

    @cached_property
    def _base(self) -> Path:
        """Folder of the splits: the root or one up to two levels below it."""
        places = [self.root, *sorted(self.root.glob("*")), *sorted(self.root.glob("*/*"))]
        return next((place for place in places if _present(place, "train")), self.root)

    def _tracks(self, folder: str) -> list[VruTrack]:
        """Tracks of a published split."""
        combined = self._combined.get(folder)
        if combined is None:
            places = self._unpacked(folder)
            named = {place.name: fingerprint_of(place / "track.json") for place in places}
        else:
            named = {name: _digest(content) for name, content in sorted(combined.items())}
        return [self._track(f"{folder}/{name}", mark) for name, mark in named.items()]

    def _track(self, key: str, mark: str) -> VruTrack:
        try:
            first, last = time_span_us(self.content(key), str(self.path(key)))
        except TrackError:
            first, last = 0, -1
        return VruTrack(key, mark, self.source(key).partition("/")[0], first, last)

    def _unpacked(self, folder: str) -> list[Path]:
        """Folders of the tracks of a published split."""
        return [path for path in sorted((self._base / folder).glob("*")) if path.is_dir()]

    @cached_property
    def _combined(self) -> dict[str, dict[str, Any]]:
        """The combined file of each published split of which no track is unpacked."""
        packed = [name for name in RELEASE_SPLITS if not self._unpacked(name)]
        paths = {name: self._base / f"{name}_tracks.json" for name in packed}
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
