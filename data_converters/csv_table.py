"""Reading of csv files, gzipped or not: every fault is told as that of a track."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd

from data_converters.errors import ConversionError, RejectReason, TrackError, refuse_track
from data_converters.plain_files import require_plain


def read_numbers(source: Path | io.BytesIO, columns: Sequence[str], where: object) -> pd.DataFrame:
    """Columns of a csv file as numbers; text where a number should be becomes NaN.

    Args:
        source: The file or its content.
        columns: What to read, in this order; the first is the clock.
        where: The file, for messages.

    Returns:
        One row per line, float64.

    Raises:
        TrackError: If it is no table or lacks a column.
    """
    with told_as_fault(where):
        table = _read(source, columns)
    require_columns(table, columns, where)
    numbers = {column: pd.to_numeric(table[column], errors="coerce") for column in columns}
    return pd.DataFrame(numbers).astype(np.float64)


@contextmanager
def told_as_fault(where: object) -> Iterator[None]:
    """Tell what goes wrong while pandas reads the file `where` as a fault of its track.

    Raises:
        TrackError: If it is no table, cut off, no plain file or too large; the last two are looked
            for where `where` is a path.
    """
    try:
        if isinstance(where, Path):
            require_plain(where)
        yield
    except gzip.BadGzipFile as error:
        reason, remedy = RejectReason.MISSING_FIELD, "Copy the file again."
        refuse_track(reason, "file", "be a csv table", error, where, remedy)
    except OSError as error:
        refuse_track(RejectReason.UNREADABLE, "file", "be a file", error, where, "Copy it again.")
    except (
        pd.errors.ParserError,
        pd.errors.EmptyDataError,
        UnicodeDecodeError,
        EOFError,
        zlib.error,
    ) as error:
        unknown = isinstance(error, UnicodeDecodeError)
        remedy = "Save it as UTF-8." if unknown else "Copy the file again."
        reason = RejectReason.MISSING_FIELD
        refuse_track(reason, "file", "be a csv table", error, where, remedy)


def require_columns(table: pd.DataFrame, columns: Sequence[str], where: object) -> None:
    """Refuse a table that lacks one of the columns, of which the first is the clock.

    Raises:
        TrackError: If one is missing.
    """
    require_header(table, where)
    missing = [column for column in columns if column not in table.columns]
    if missing:
        reason = RejectReason.NO_TIMESTAMPS if columns[0] in missing else RejectReason.MISSING_FIELD
        found, remedy = list(table.columns), "Copy the file again."
        refuse_track(reason, "columns", f"contain {missing}", found, where, remedy)


def require_header(table: pd.DataFrame, where: object) -> None:
    """Refuse a table whose rows are longer than its header, so that columns have wrong names.

    Raises:
        TrackError: They are.
    """
    if not isinstance(table.index, pd.RangeIndex):
        needs, found = "name every column", f"{len(table.columns)} names for more columns"
        remedy = "Name them, remove separators at the ends of lines, or copy the file again."
        refuse_track(RejectReason.MISSING_FIELD, "header", needs, found, where, remedy)


def read_by_name(
    path: Path, names: Sequence[str], numbers: Sequence[str]
) -> dict[str, tuple[float, ...]]:
    """Numbers of each row of a small table beside the recordings, such as their scales.

    Args:
        path: The csv file; none if it is not there.
        names: Columns whose values, joined by "_", name a row.
        numbers: Columns to read.

    Returns:
        The numbers by name, NaN for what is none; of a name that comes twice with other numbers,
        which cannot be trusted, NaN too.

    Raises:
        ConversionError: If it is no table or lacks a column.
    """
    if not path.exists():
        return {}
    try:
        with told_as_fault(path):
            table = pd.read_csv(path, dtype=str)
        require_columns(table, (*names, *numbers), path)
    except TrackError as error:
        raise ConversionError(str(error)) from error
    found: dict[str, tuple[float, ...]] = {}
    keys = table[list(names)].astype(str).agg("_".join, axis=1)
    values = table[list(numbers)].apply(pd.to_numeric, errors="coerce").astype(np.float64)
    for key, row in zip(keys, values.to_numpy().tolist(), strict=True):
        known = found.setdefault(key, tuple(row))
        if known != tuple(row):
            found[key] = (float("nan"),) * len(numbers)
    return found


def _read(source: Path | io.BytesIO, columns: Sequence[str]) -> pd.DataFrame:
    """The table of a file, slower where a number is missing.

    All of it: of some columns alone pandas would take rows that are too long for its header.
    """
    try:
        return pd.read_csv(source, dtype=dict.fromkeys(columns, np.float64))
    except ValueError:
        if isinstance(source, io.BytesIO):
            source.seek(0)
        return pd.read_csv(source)
