"""Reading of the TH-AB csv files, from folders or from the archives they come in."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.csv_table import read_numbers
from data_converters.errors import ConversionError, RejectReason, fault, refuse_track, require
from data_converters.thab.modes import FOLDER_MODES, PHASES

COLUMNS = ("timestamp", "x", "y")


class ThabFile(NamedTuple):
    """One csv file: group ("cyclists"), phase, stem of its name, and its bytes."""

    group: str
    phase: str
    stem: str
    content: bytes

    @property
    def path(self) -> str:
        """Path inside the data set."""
        return f"{self.group}/{self.phase}/{self.stem}.csv"


def read_files(root: Path) -> list[ThabFile]:
    """All csv files below `root`, sorted by path; folders are preferred to archives.

    Raises:
        ConversionError: If neither folders nor archives with the known names are there, or an
            archive is broken.
    """
    files = [file for group in FOLDER_MODES for file in _read_group(root, group)]
    names = ", ".join(f"{group}/ or {group}.tar.gz" for group in FOLDER_MODES)
    found = "no such folder" if not root.is_dir() else "none of them"
    remedy = "Give the folder of the TH-AB VRU tracks."
    require(bool(files), "root", f"hold {names}", found, root, remedy)
    return sorted(files, key=lambda file: file.path)


def _read_group(root: Path, group: str) -> Iterator[ThabFile]:
    folder, archive = root / group, root / f"{group}.tar.gz"
    if folder.is_dir():
        for phase in PHASES:
            for path in (folder / phase).glob("*.csv"):
                yield ThabFile(group, phase, path.stem, path.read_bytes())
    elif archive.is_file():
        yield from _read_archive(archive, group)


def _read_archive(archive: Path, group: str) -> Iterator[ThabFile]:
    try:
        with tarfile.open(archive, "r:gz") as tar:
            for member in tar:
                path = Path(member.name)
                stream = tar.extractfile(member) if path.suffix == ".csv" else None
                if stream is not None and path.parent.name in PHASES:
                    yield ThabFile(group, path.parent.name, path.stem, stream.read())
    except (tarfile.TarError, EOFError, OSError) as error:
        told = fault("archive", "be whole", error, archive, "Copy the archive again.")
        raise ConversionError(f"{told}") from error


def parse(file: ThabFile) -> NDArray[np.float64]:
    """Columns timestamp (s), x, y (m) of one file, (n, 3).

    Raises:
        TrackError: If a column is missing, a value is no finite number, or the clock stands still.
    """
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
    if len(values) > 1 and not np.any(np.diff(values[:, 0]) > 0.0):
        refuse_track(
            RejectReason.REPEATED_TIMESTAMPS,
            "timestamp",
            "increase",
            values[:2, 0],
            file.path,
            "The file has no clock.",
        )
    return values
