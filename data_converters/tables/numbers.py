"""Numbers that cannot be read: which file, line and column they stand in, and what to change."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from data_converters.errors import fault, require
from data_converters.tables.columns import TableColumns
from data_converters.tables.units import MARKS, TEXT_TIME, TableUnits

MOST = 0.5
"""Share of the values of a column that tells how its numbers are written."""
IF_DATES = "Correct it, remove the row, or set data.units.time=iso for dates and times."


def require_numbers(
    rows: pd.DataFrame, columns: TableColumns, units: TableUnits, path: Path
) -> None:
    """Refuse a table with a column of text in the place of numbers, or with other decimal marks.

    Args:
        rows: The table as it was read.
        columns: Which columns hold numbers.
        units: How numbers and times are written.
        path: The file, for messages.

    Raises:
        ConversionError: The message names file, line, column, value and setting.
    """
    for column in columns.numbers():
        values = rows[column].dropna()
        if len(values) == 0 or pd.api.types.is_numeric_dtype(values):
            continue
        _require_mark(values, column, units, path)
        dates = column == columns.time and units.time == TEXT_TIME
        needs, remedy = "hold numbers", "Name another column, or none, or correct it."
        if column == columns.time:
            remedy = IF_DATES
        readable = dates or bool(units.numbers(values).notna().any())
        where = _place(path, int(values.index[0]), column)
        require(readable, column, needs, values.iloc[0], where, remedy)


def _require_mark(values: pd.Series, column: str, units: TableUnits, path: Path) -> None:
    """Refuse decimal commas where a point is set, or the reverse."""
    (other,) = MARKS.keys() - {units.decimal}
    needs, remedy = f"be '{units.decimal}' in numbers", f"Set data.units.decimal={other}."
    written = values.astype(str).str.fullmatch(rf"\s*[+-]?\d*{re.escape(MARKS[other])}\d+\s*")
    where = _place(path, int(written.idxmax()), column)
    fits = bool(written.mean() <= MOST)
    require(fits, "units.decimal", needs, values[written.idxmax()], where, remedy)


def with_faults(
    table: pd.DataFrame, rows: pd.DataFrame, columns: TableColumns, units: TableUnits, path: Path
) -> pd.DataFrame:
    """Tell, in a column `fault`, what is wrong with the first unreadable row of each agent.

    Args:
        table: Columns agent, time_s, x and y, made of `rows`.
        rows: The table as it was read.
        columns: Names of its columns.
        units: How times are written.
        path: The file, for messages.

    Returns:
        `table`, with the column if there is such a row.
    """
    finite = pd.DataFrame(np.isfinite(table[["time_s", "x", "y"]]))
    first = table[~finite.all(axis=1)].drop_duplicates("agent").index
    if len(first) == 0:
        return table
    names = {"time_s": columns.time, "x": columns.x, "y": columns.y}
    told = {}
    for row in first:
        column = names[str(finite.loc[row].idxmin())]
        value, where = rows.loc[row, column], _place(path, int(row), column)
        needs, remedy = "be a finite number", "Correct or remove the row."
        if column == columns.time and units.time == TEXT_TIME:
            needs = "be a date and time such as 2026-05-04T12:00:00.1"
        elif column == columns.time:
            remedy = IF_DATES
        told[row] = fault(column, needs, "nothing" if pd.isna(value) else value, where, remedy)
    return table.assign(fault=pd.Series(told, dtype=object))


def _place(path: Path, row: int, column: str) -> str:
    """Where a value stands; rows of a file without lines count from 1."""
    line = f"row {row + 1}" if path.suffix == ".parquet" else f"line {row + 2}"
    return f"{path}, {line}, column '{column}'"
