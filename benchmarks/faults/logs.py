"""Logs of the Autobike: clocks, positions and sensors that cannot be."""

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pandas as pd

from benchmarks.faults.crowds import gzipped
from benchmarks.faults.tables import NO_FILES, Content, Layout, put, spoiled
from benchmarks.faults.trial import Result, Trial, Usual, converted, each, told_by
from data_converters import AutobikeDataset, ConversionSettings, convert
from data_converters.autobike.reader import (
    COLUMNS,
    LATITUDE,
    LONGITUDE,
    ROLL,
    ROLL_RATE,
    SIDEWAYS,
    STEER,
    TIME,
    WHEEL,
    YAW_RATE,
)
from tests.data_converters.synthetic import autobike_log

SENSORS = (STEER, WHEEL, ROLL_RATE, YAW_RATE, SIDEWAYS, ROLL)
Change = Callable[[pd.DataFrame], pd.DataFrame]


@cache
def log() -> pd.DataFrame:
    """A whole log."""
    return autobike_log()[list(COLUMNS)]


def written(table: pd.DataFrame) -> str:
    """A log as text."""
    return table.to_csv(index=False, float_format="%.12g")


@cache
def whole() -> Usual:
    """What a conversion tells of two whole logs."""
    root = Path(mkdtemp())
    good(root)
    (root / "09_06" / "9.csv").write_text(written(log()) + "\n")
    return told_by(convert(ConversionSettings(AutobikeDataset(root), root / "c", progress=False)))


def good(root: Path) -> Path:
    """Write the log that has to be kept; the folder of it."""
    place = root / "09_06"
    place.mkdir(parents=True)
    (place / "0.csv").write_text(written(log()))
    return place


def tried(content: Content, name: str, folder: Path) -> Result:
    """Convert a good log and a broken one."""
    put(good(folder) / name, content)
    return converted(AutobikeDataset(folder), folder, 1, whole())


def at(column: str, value: object, rows: slice = slice(1000, 1001)) -> Change:
    """Put a value into some rows of a column."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        table = table.astype({column: object})
        table.loc[table.index[rows], column] = value
        return table

    return change


def changes() -> Iterator[tuple[str, Change]]:
    """Logs whose columns do not say what they should."""
    everywhere = slice(None)
    for column in SENSORS:
        for name, value in {"NaN": "nan", "inf": "inf", "1e300": 1e300, "text": "x"}.items():
            yield f"{name} in {column}", at(column, value)
        yield f"NaN throughout {column}", at(column, "nan", everywhere)
        yield f"no column {column}", lambda t, c=column: t.drop(columns=c)
    for column in (LATITUDE, LONGITUDE):
        yield f"0 for a second in {column}", at(column, 0.0, slice(1000, 1100))
        yield f"0 throughout {column}", at(column, 0.0, everywhere)
        yield (
            f"a jump of the receiver in {column}",
            lambda t, c=column: t.assign(**{c: t[c] + 1e-5 * (np.arange(len(t)) == 1000)}),
        )
        yield (
            f"{column} on the other side",
            lambda t, c=column: t.assign(**{c: np.where(np.arange(len(t)) < 1000, t[c], -t[c])}),
        )
    yield "a dead wheel", at(WHEEL, 0.0, everywhere)
    yield "a dead gyroscope", at(YAW_RATE, 0.0, everywhere)
    yield "a gyroscope turned over", lambda t: t.assign(**{YAW_RATE: -t[YAW_RATE]})
    yield "a wheel in rpm", lambda t: t.assign(**{WHEEL: t[WHEEL] * 30 / np.pi})
    yield "no speed in a slow wheel", lambda t: t.assign(**{WHEEL: 0.6 * t[WHEEL]})
    yield (
        "a clock that goes back",
        lambda t: t.assign(**{TIME: t[TIME] - 5000 * (np.arange(len(t)) > 1000)}),
    )
    yield (
        "a clock that starts anew",
        lambda t: t.assign(
            **{TIME: np.where(np.arange(len(t)) > 1000, t[TIME] - 875_426, t[TIME])}
        ),
    )
    yield "rows from last to first", lambda t: t[::-1]
    yield "the same row 2,000 times", lambda t: t.iloc[[0] * len(t)]


def trials() -> Iterator[Trial]:
    """All faults of these files."""
    kind, rows = "Autobike logs", log().to_numpy().tolist()
    layout, place = Layout(COLUMNS), COLUMNS.index(LATITUDE)
    contents: dict[str, Content] = {
        **spoiled(layout, rows, COLUMNS.index(TIME), place),
        **NO_FILES,
        **{name: written(change(log())) for name, change in changes()},
        "a copy of another log": written(log()),
    }
    yield from each(kind, ((n, partial(tried, c, "9.csv")) for n, c in contents.items()))
    archives = gzipped(written(log()))
    yield from each(kind, ((n, partial(tried, c, "9.csv.gz")) for n, c in archives))
