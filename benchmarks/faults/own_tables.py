"""Tables of one's own as Parquet, and descriptions of them that fit no table."""

import io
from collections.abc import Iterator
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.faults.tables import ENDLESS, NO_FILES, Content, put
from benchmarks.faults.trial import Result, Trial, converted, each
from data_converters import (
    ConversionSettings,
    RecordingSplit,
    TableColumns,
    TableDataset,
    TableUnits,
    convert,
)
from data_converters.tables.units import Plausibility

TIME_S = np.arange(0.0, 8.0, 0.1)


def table(**changes: Any) -> pd.DataFrame:
    """A rider who goes east at 4 m/s."""
    columns = {"time": TIME_S, "x": 4.0 * TIME_S, "y": 1.0, "agent": "a", "type": "bicycle"}
    return pd.DataFrame(columns | changes)


def parquet(content: pd.DataFrame) -> bytes:
    """A Parquet file."""
    stream = io.BytesIO()
    content.to_parquet(stream, index=False)
    return stream.getvalue()


def tried(content: Content, folder: Path) -> Result:
    """Convert a good table and a broken one."""
    (folder / "a.parquet").write_bytes(parquet(table()))
    put(folder / "b.parquet", content)
    return converted(TableDataset(folder), folder, 1)


def damaged() -> Iterator[tuple[str, Content]]:
    """Parquet files that were cut off or changed, and what is none."""
    whole = parquet(table(agent="b"))
    for part in range(10):
        yield f"cut at {part}0 %", whole[: part * len(whole) // 10]
    yield "its end changed", whole[:-9] + bytes(9)
    yield "a length of its end changed", whole[:-8] + b"\xff\xff\xff\x7f" + whole[-4:]
    yield "text", b"time,x,y,agent,type\n0,0,0,b,bicycle\n"
    yield from NO_FILES.items()
    yield from ENDLESS.items()


def strange() -> Iterator[tuple[str, bytes]]:
    """Parquet files that hold other things than numbers and names."""
    nested = [[value] for value in TIME_S]
    for name, values in {
        "lists": nested,
        "texts": [f"{value} s" for value in TIME_S],
        "nothing": None,
        "bytes": [b"\xff\x00"] * len(TIME_S),
        "infinite numbers": np.full(len(TIME_S), np.inf),
        "dates": pd.date_range("2026-01-01", periods=len(TIME_S), freq="D"),
    }.items():
        for column in ("time", "x"):
            yield f"{name} in {column}", parquet(table(agent="b", **{column: values}))
    for name, values in {"lists": nested, "nothing": None, "numbers": 7.5}.items():
        yield f"{name} as a type", parquet(table(agent="b", type=values))
    yield "an empty table", parquet(table(agent="b")[:0])
    yield "one row", parquet(table(agent="b")[:1])
    yield "no columns", parquet(pd.DataFrame())
    yield "lists as agents", parquet(table(agent=nested))
    yield "true and false as y", parquet(table(agent="b", y=[True, False] * 40, x=None))
    yield "decimals that are none", parquet(table(agent="b", x=[Decimal("NaN")] * len(TIME_S)))


def described(options: dict[str, Any], folder: Path) -> Result:
    """Convert a good table with a description that cannot be."""
    (folder / "a.parquet").write_bytes(parquet(table()))
    dataset = TableDataset(folder, **{name: make() for name, make in options.items()})
    convert(ConversionSettings(dataset, folder / "cache", progress=False))
    return Result.SILENT


DESCRIPTIONS: dict[str, dict[str, Any]] = {
    "no column of the time": {"columns": lambda: TableColumns(time="t")},
    "an empty name of a column": {"columns": lambda: TableColumns(x="")},
    "none as a column": {"columns": lambda: TableColumns(y=None)},  # type: ignore[arg-type]
    "no column of the agent": {"columns": lambda: TableColumns(agent="who")},
    "no column of the type": {"columns": lambda: TableColumns(type="kind")},
    "no column of a control": {"columns": lambda: TableColumns(controls={"steer": "delta"})},
    "no column of the scene": {"columns": lambda: TableColumns(scene="place")},
    "no column of the recording": {"columns": lambda: TableColumns(recording="day")},
    "no type and no mode": {"columns": lambda: TableColumns(type=None)},
    "an unknown mode": {"mode": lambda: "horse"},
    "an unknown mode of a type": {"types": lambda: {"bicycle": "horse"}},
    "a mode that is a list": {"types": lambda: {"bicycle": ["bicycle"]}},
    "types that leave out the one there is": {"types": lambda: {"bike": "bicycle"}},
    "milliseconds": {"units": lambda: TableUnits(time="ms")},
    "dates for seconds": {"units": lambda: TableUnits(time="iso")},
    "furlongs": {"units": lambda: TableUnits(length="furlong")},
    "an unknown angle": {"units": lambda: TableUnits(angle="grad")},
    "an unknown speed": {"units": lambda: TableUnits(speed="kn")},
    "kilometres": {"units": lambda: TableUnits(length="km")},
    "another rate": {"plausible": lambda: Plausibility(rate_hz=25.0)},
    "a rate of 0": {"plausible": lambda: Plausibility(rate_hz=0.0)},
    "a rate of NaN": {"plausible": lambda: Plausibility(rate_hz=float("nan"))},
    "a largest speed of 0": {"plausible": lambda: Plausibility(max_speed_mps=0.0)},
    "a name with a hyphen": {"called": lambda: "a-b"},
    "a name that leads away": {"called": lambda: "../a"},
    "an empty name": {"called": lambda: ""},
    "a split for what is not there": {"split": lambda: RecordingSplit(given={"z": "test"})},
    "an unknown split": {"split": lambda: RecordingSplit(given={"a": "exam"})},
}


def trials() -> Iterator[Trial]:
    """All faults of these files and of what is said of them."""
    contents = [*damaged(), *strange()]
    yield from each("Parquet tables", ((n, partial(tried, c)) for n, c in contents))
    wrong = ((n, partial(described, options)) for n, options in DESCRIPTIONS.items())
    yield from each("descriptions of tables", wrong)
