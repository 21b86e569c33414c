"""Reading of tables, CSV or Parquet, and of the names in their columns."""

from __future__ import annotations

import gzip
import re
from collections.abc import Collection
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from data_converters.csv_table import require_header, told_as_fault
from data_converters.errors import RejectReason, TrackError, refuse_track
from data_converters.plain_files import require_plain

SEPARATORS = (",", ";", "\t", "|")


def read_table(path: Path, names: Collection[str], numbers: Collection[str] = ()) -> pd.DataFrame:
    """A table as it is, its rows numbered from 0; names of text files without blanks around them.

    Args:
        path: The file.
        names: Columns that hold names: a number of many digits stays as it is written.
        numbers: Columns that hold numbers; all others are not read, and may have any name.

    Raises:
        TrackError: If it is none, or has a column that is read twice.
    """
    if path.suffix != ".parquet":
        with told_as_fault(path):
            read = partial(pd.read_csv, path, sep=_separator(path), encoding="utf-8-sig")
            written = [str(column) for column in read(nrows=0).columns]
            table = read(dtype={each: str for each in written if each.strip() in names})
        require_header(table, path)
        table = table.rename(columns=str.strip)
        twice = sorted({*names, *numbers} & set(table.columns[table.columns.duplicated()]))
        if twice:
            needs, remedy = "name every column once", "Rename one, blanks do not count."
            refuse_track(RejectReason.MISSING_FIELD, "header", needs, twice, path, remedy)
        return table
    from pyarrow.lib import ArrowException

    try:
        require_plain(path)
        table = pd.read_parquet(path)
        # pandas keeps in it that a column was the index of the table
        own = [name for name in table.index.names if name and name not in table.columns]
        return table.reset_index(own).reset_index(drop=True)
    except TrackError:
        raise
    except (OSError, ValueError, TypeError, ArrowException) as error:
        remedy = "Write the file again."
        refuse_track(RejectReason.MISSING_FIELD, "file", "be a table", error, path, remedy)


def _separator(path: Path) -> str:
    """The one of , ; tab | that is most frequent in the first line."""
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        first = file.readline()
    return max(SEPARATORS, key=first.count)


def names_of(column: pd.Series) -> pd.Series:
    """Names that a column holds, as text; NaN where there is none.

    A number that a gap turned into 7.0 is 7.
    """
    # a table has few names, each in many rows
    codes, values = pd.factorize(column)
    names = [*map(_name, values.tolist()), None]
    return pd.Series([names[code] for code in codes], column.index, dtype=object).fillna(np.nan)


def _name(value: object) -> str | None:
    if isinstance(value, float):
        return f"{value:.0f}" if value.is_integer() else repr(value)
    return re.sub(r"^(-?\d+)\.0+$", r"\1", str(value).strip()) or None
