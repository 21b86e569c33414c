"""Recordings in CSV files: TH-AB tracks and two-wheeler rides, whole and broken."""

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.faults.trial import Result, Trial, converted, each
from data_converters import ThabVruDataset, TwoWheelerDataset

TIME = np.arange(0.0, 6.0, 0.08)
FRAMES = np.arange(24) / 2
THAB = ("", "timestamp", "x", "y")
BOXES = ("time_s", "obj_id", "x", "y", "z", "qx", "qy", "qz", "qw", "sx", "sy", "sz")
Rows = list[list[object]]
Content = str | bytes | Callable[[Path], object]


class Layout(NamedTuple):
    """How a table of text is written."""

    header: tuple[str, ...]
    separator: str = ","
    headed: bool = True

    def text(self, rows: Rows) -> str:
        """The file."""
        lines = [list(self.header), *rows] if self.headed else rows
        return "\n".join(self.separator.join(map(str, row)) for row in lines) + "\n"


def thab_rows(offset: float = 0.0) -> Rows:
    """A rider at 3 m/s."""
    return [[i, t, 3.0 * t, offset] for i, t in enumerate(TIME)]


def box_rows() -> Rows:
    """A ride at 6 m/s."""
    return [[t, 0, 1.0, 0.0, 6.0 * t, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0] for t in FRAMES]


def text(header: tuple[str, ...], rows: Rows) -> str:
    """A CSV file."""
    return Layout(header).text(rows)


def column(rows: Rows, index: int, change: Callable[[float, int], object]) -> Rows:
    """Rows with one column changed."""
    return [
        [*row[:index], change(float(str(row[index])), i), *row[index + 1 :]]
        for i, row in enumerate(rows)
    ]


def spoiled_rows(rows: Rows, time: int, place: int) -> Iterator[tuple[str, Rows]]:
    """Rows of one agent with impossible numbers by name, its clock and a coordinate there."""
    half = len(rows) // 2
    for name, value in {
        "NaN": "nan", "infinite": "inf", "no": "", "text for a": "one", "1e308 as": 1e308,
        "-1e308 as": -1e308, "1e9 m as": 1e9, "a jump of 900 m in": 900.0, "1e400 as": "1e400",
        "a date as": "2024-01-01",
    }.items():  # fmt: skip
        yield f"{name} coordinate", column(rows, place, lambda x, i, v=value: v if i == half else x)
    for name, value in {
        "NaN": "nan", "infinite": "inf", "minus infinite": "-inf", "no": "", "text for a": "noon",
    }.items():  # fmt: skip
        yield f"{name} time", column(rows, time, lambda t, i, v=value: v if i == half else t)
    for name, change in {
        "time in ms": lambda t, i: 1e3 * t,
        "time in µs": lambda t, i: 1e6 * t,
        "time times 1e300": lambda t, i: 1e300 * t,
        "all times equal": lambda t, i: 7.0,
        "half a year later": lambda t, i: t + (1.6e7 if i > half else 0),
        "first sample ten years early": lambda t, i: t - (3.2e8 if i == 0 else 0),
        "time times 1e-9": lambda t, i: 1e-9 * t,
    }.items():
        yield name, column(rows, time, change)
    for name, factor in {
        "millimetres": 1e3,
        "centimetres": 1e2,
        "40 times too far": 40.0,
    }.items():
        yield name, column(rows, place, lambda x, i, f=factor: f * x)


def spoiled_files(layout: Layout, rows: Rows, time: int, place: int) -> Iterator[tuple[str, str]]:
    """Files that are no such table, by name."""
    whole, sign = layout.text(rows), layout.separator
    for index in sorted({time, place}):
        kept = [i for i in range(len(layout.header)) if i != index]
        less = layout._replace(header=tuple(layout.header[i] for i in kept))
        yield (
            f"no column {layout.header[index]}",
            less.text([[row[i] for i in kept] for row in rows]),
        )
    yield "empty file", ""
    yield "header only", layout.text([])
    yield "one row", layout.text(rows[:1])
    yield "three rows", layout.text(rows[:3])
    if layout.headed:
        yield "no header", "\n".join(whole.splitlines()[1:])
        yield (
            "rows with more columns than the header",
            whole.replace("\n", f"{sign}9{sign}9\n").replace(f"{sign}9{sign}9", "", 1),
        )
    yield "another separator", whole.replace(sign, "#")
    yield (
        "a row cut off",
        whole[: len(whole) // 2].rsplit(sign, 1)[0] + "\n" + sign.join("12345678901234") + "\n",
    )
    yield "zero bytes", "\0" * 500
    yield "a web page", "<html><body>404</body></html>"


def spoiled(layout: Layout, rows: Rows, time: int, place: int) -> dict[str, str]:
    """All broken contents of a file with one agent."""
    numbers = {name: layout.text(each) for name, each in spoiled_rows(rows, time, place)}
    return numbers | dict(spoiled_files(layout, rows, time, place))


def thab(content: Content, folder: Path) -> Result:
    """Convert one good cyclist and a broken one."""
    place = folder / "cyclists" / "moving"
    place.mkdir(parents=True)
    (place / "20.csv").write_text(text(THAB, thab_rows()))
    put(place / "21.csv", content)
    return converted(ThabVruDataset(folder), folder, 1)


def rides(content: Content, folder: Path) -> Result:
    """Convert a good ride and a broken one."""
    (folder / "bicycle.csv").write_text(text(BOXES, box_rows()))
    put(folder / "scooter.csv", content)
    return converted(TwoWheelerDataset(folder), folder, 1)


def put(path: Path, content: Content) -> None:
    """Write a file, or what is none."""
    if callable(content):
        content(path)
    elif isinstance(content, bytes):
        path.write_bytes(content)
    else:
        path.write_text(content)


def truncated(path: Path, size: int) -> None:
    """A file of zeros that takes no space."""
    path.touch()
    os.truncate(path, size)


NO_FILES: dict[str, bytes | Callable[[Path], object]] = {
    "a folder": Path.mkdir,
    "a dangling link": lambda path: path.symlink_to("nowhere"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "no UTF-8": b"\xff\xfe\x00" * 99,
}
ENDLESS: dict[str, Callable[[Path], object]] = {
    "a pipe": os.mkfifo,
    "a link to zeros without end": lambda path: path.symlink_to("/dev/zero"),
    "a large file of zeros": partial(truncated, size=1 << 40),
}


def trials() -> Iterator[Trial]:
    """All faults of these files."""
    contents = {**spoiled(Layout(THAB), thab_rows(9.0), 1, 2), **NO_FILES, **ENDLESS}
    yield from each("TH-AB tracks", ((n, partial(thab, c)) for n, c in contents.items()))
    contents = {**spoiled(Layout(BOXES), box_rows(), 0, 4), **NO_FILES, **ENDLESS}
    for name, part in {
        "zero": (0.0,) * 4,
        "long": (0.0, 0.0, 0.0, 9.0),
        "NaN": ("nan",) * 4,
    }.items():
        rows = [[*row[:5], *part, *row[9:]] for row in box_rows()]
        contents[f"{name} quaternions"] = text(BOXES, rows)
    contents["no box of the rider"] = text(BOXES, column(box_rows(), 1, lambda x, i: 3))
    yield from each("two-wheeler rides", ((n, partial(rides, c)) for n, c in contents.items()))
