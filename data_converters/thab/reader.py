"""Reading of the TH-AB csv files, from folders or from the archives they come in."""

from __future__ import annotations

import io
import logging
import tarfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.archives import reaches_outside, whole_tar
from data_converters.csv_table import read_numbers
from data_converters.errors import RejectReason, TrackError, fault, refuse_track, require
from data_converters.limits import USUAL, RecordingLimits
from data_converters.plain_files import LARGEST_BYTES, require_plain
from data_converters.tables.outputs import recorded
from data_converters.thab.modes import FOLDER_MODES, PHASES

logger = logging.getLogger(__name__)

COLUMNS = ("timestamp", "x", "y")
ENDINGS = (".csv", ".csv.gz")
"""Of what looks like a track, read or not."""


class ThabFile(NamedTuple):
    """One csv file: group ("cyclists"), phase, stem of its name, and its bytes, or why none.

    `place` is empty, or tells files apart that have the same name in an archive.
    """

    group: str
    phase: str
    stem: str
    content: bytes | TrackError
    place: str = ""

    @property
    def path(self) -> str:
        """Path inside the data set."""
        return f"{self.group}/{self.phase}/{self.stem}{self.place}.csv"


def read_files(root: Path) -> list[ThabFile]:
    """All csv files below `root`, sorted by path; folders with files are preferred to archives.

    A warning tells of csv files, packed ones as well, that stand elsewhere and are not read.

    Raises:
        ConversionError: If neither folders nor archives with the known names are there, one of them
            holds no file, or an archive is broken.
    """
    files = [file for group in FOLDER_MODES for file in _read_group(root, group)]
    names = ", ".join(f"{group}/ or {group}.tar.gz" for group in FOLDER_MODES)
    found = "no such folder" if not root.is_dir() else "none of them"
    remedy = "Give the folder of the TH-AB VRU tracks."
    require(bool(files), "root", f"hold {names}", found, root, remedy)
    read = {root / file.path for file in files}
    tables = (path for ending in ENDINGS for path in root.rglob(f"*{ending}"))
    _tell_unread([str(path) for path in recorded(tables, root) if path not in read])
    return sorted(files, key=lambda file: file.path)


def _tell_unread(names: list[str]) -> None:
    """Warn of tables that stand where none are looked for, or are packed one by one."""
    if names:
        groups, phases = "|".join(FOLDER_MODES), "|".join(PHASES)
        told = "Files that are not read: %d, the first: %s. Read are (%s)/(%s)/NAME.csv."
        logger.warning(told, len(names), names[0], groups, phases)


def _read_group(root: Path, group: str) -> list[ThabFile]:
    """The files of a group, none where neither its folder nor its archive is there."""
    folder, archive = root / group, root / f"{group}.tar.gz"
    paths = [(phase, path) for phase in PHASES for path in (folder / phase).glob("*.csv")]
    files = [ThabFile(group, phase, path.stem, _content(path)) for phase, path in paths]
    place = folder
    if not files and archive.is_file():
        place, files = archive, list(_read_archive(archive, group))
    found, phases = "none", f"files such as {PHASES[0]}/1.csv (also {', '.join(PHASES[1:])})"
    remedy = f"Unpack {group}.tar.gz again, or remove what is empty."
    there = bool(files) or not (folder.exists() or archive.exists())
    require(there, group, f"hold {phases}", found, place, remedy)
    return files


def _content(path: Path) -> bytes | TrackError:
    """The bytes of a file, or why it has none: a folder, a dangling link, no permission."""
    try:
        require_plain(path)
        return path.read_bytes()
    except TrackError as refused:
        return refused
    except OSError as error:
        return _refused(RejectReason.UNREADABLE, "be a readable file", error, path)


def _refused(reason: RejectReason, needs: str, found: object, where: object) -> TrackError:
    return TrackError(fault("file", needs, found, where, "Copy the file again."), reason)


def _read_archive(archive: Path, group: str) -> Iterator[ThabFile]:
    """The csv files of an archive; members that no folder could hold are told, not left out."""
    known: Counter[tuple[str, str]] = Counter()
    unread: list[str] = []
    with whole_tar(archive) as tar:
        for member in tar:
            path = PurePosixPath(member.name)
            phase, stem = path.parent.name, path.stem
            if path.suffix != ".csv" or not (phase in PHASES or reaches_outside(member.name)):
                unread += [f"{archive}, {member.name}"] if path.name.endswith(ENDINGS) else []
                continue
            content = _member(tar, member, f"{archive}, {member.name}")
            phase = phase if phase in PHASES else "elsewhere"
            known[phase, stem] += 1
            count = known[phase, stem]
            if count > 1 and isinstance(content, bytes):
                reason, needs = RejectReason.REPEATED_FILE, "stand in the archive once"
                content = _refused(reason, needs, f"{member.name} again", archive)
            yield ThabFile(group, phase, stem, content, f"#{count}" if count > 1 else "")
    _tell_unread(unread)


def _member(tar: tarfile.TarFile, member: tarfile.TarInfo, where: str) -> bytes | TrackError:
    """The bytes of a member, or why it is refused."""
    reason = RejectReason.UNSAFE_MEMBER
    if reaches_outside(member.name):
        return _refused(reason, "stay within the archive", member.name, where)
    if not member.isreg():
        found = f"a link to {member.linkname!r}" if member.linkname else "no file"
        return _refused(reason, "be a plain file", found, where)
    if member.size > LARGEST_BYTES:
        return _refused(reason, f"have at most {LARGEST_BYTES} bytes", member.size, where)
    stream = tar.extractfile(member)
    return b"" if stream is None else stream.read()


def parse(file: ThabFile, limits: RecordingLimits = USUAL) -> NDArray[np.float64]:
    """Columns timestamp (s), x, y (m) of one file, (n, 3).

    Raises:
        TrackError: If the file could not be read, is empty, lacks a column, holds a value that is
            not finite or beyond the limits, or its clock stands still.
    """
    if isinstance(file.content, TrackError):
        raise file.content
    table = read_numbers(io.BytesIO(file.content), COLUMNS, file.path)
    values = table.to_numpy(dtype=np.float64)
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        place = f"{file.path}, row {row}"
        refuse_track(
            RejectReason.NOT_FINITE,
            "timestamp, x, y",
            "be finite",
            values[row],
            place,
            "Remove the file.",
        )
    if len(values) == 0:
        needs, remedy = "hold samples", "Copy the file again."
        refuse_track(RejectReason.TOO_SHORT, "file", needs, "none", file.path, remedy)
    limits.check_samples(values[:, 0], values[:, 1:], file.path)
    if len(values) > 1 and np.ptp(values[:, 0]) == 0.0:
        refuse_track(
            RejectReason.REPEATED_TIMESTAMPS,
            "timestamp",
            "increase",
            values[:2, 0],
            file.path,
            "The file has no clock.",
        )
    return values
