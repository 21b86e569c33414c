"""What a page is made of: tables, charts, pictures and scenes, each with a template of its own."""

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from diffstack_mmv.reporting.table import cell

PICTURES = {".png": "image/png", ".gif": "image/gif"}


@dataclass(frozen=True)
class Note:
    """A paragraph."""

    template: ClassVar[str] = "note.html.j2"
    text: str


@dataclass(frozen=True)
class Table:
    """Rows of text under headings."""

    template: ClassVar[str] = "table.html.j2"
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Chart:
    """Lines over a common axis, drawn in the browser.

    Attributes:
        title: Heading.
        x_title: Title and unit of the axis.
        y_title: Title and unit of the values.
        lines: Name -> (x, y) of the same length; unknown values are left out.
        marks: Whether each value gets a dot.
    """

    template: ClassVar[str] = "chart.html.j2"
    title: str
    x_title: str
    y_title: str
    lines: Mapping[str, tuple[Sequence[float], Sequence[float | None]]]
    marks: bool = False

    def content(self) -> Any:
        """What the script of the page draws."""
        lines = [{"name": k, "x": plain(x), "y": plain(y)} for k, (x, y) in self.lines.items()]
        return {"x": self.x_title, "y": self.y_title, "marks": self.marks, "lines": lines}


@dataclass(frozen=True)
class Bars:
    """Values of several methods in groups, drawn in the browser.

    Attributes:
        title: Heading.
        y_title: Title and unit of the values.
        groups: Names of the groups.
        values: Name of the method -> one value per group.
    """

    template: ClassVar[str] = "bars.html.j2"
    title: str
    y_title: str
    groups: Sequence[str]
    values: Mapping[str, Sequence[float | None]]

    def content(self) -> Any:
        """What the script of the page draws."""
        values = {name: plain(entries) for name, entries in self.values.items()}
        return {"y": self.y_title, "groups": list(self.groups), "values": values}


@dataclass(frozen=True)
class Gallery:
    """Pictures, embedded in the page."""

    template: ClassVar[str] = "gallery.html.j2"
    title: str
    files: Sequence[Path]

    def pictures(self) -> list[tuple[str, str, bool]]:
        """Name and address (with the whole content) of each picture, and whether it is wide."""
        return [(_caption(file), _address(file), _is_wide(file)) for file in self.files]


@dataclass(frozen=True)
class Scenes:
    """Scenes that play in the browser, one at a time, under a slider over time.

    Attributes:
        title: Heading.
        scenes: What `scenes.py` makes of the records of a run.
    """

    template: ClassVar[str] = "scenes.html.j2"
    title: str
    scenes: Sequence[Mapping[str, Any]]


Block = Note | Table | Chart | Bars | Gallery | Scenes
"""A part of a section; `template` is the file that shows it."""


@dataclass(frozen=True)
class Section:
    """Blocks under one heading."""

    title: str
    blocks: Sequence[Block]


def plain(values: Any, digits: int = 4) -> Any:
    """Numbers for JSON: nested lists of so many significant places after the point, None for NaN.

    Args:
        values: An array, or anything that makes one of floats (None is NaN).
        digits: Decimal places.
    """
    array = np.asarray(values, np.float64)
    rounded = np.where(np.isfinite(array), np.round(array, digits), np.nan).tolist()
    return _without_nan(rounded)


def frame_table(title: str, frame: pd.DataFrame, index: bool = False, digits: int = 3) -> Table:
    """A table from a data frame; unknown numbers are dashes."""
    shown = frame.rename_axis(index=str(frame.index.name or "")).reset_index() if index else frame
    rows = [[cell(value, f".{digits}f") for value in row] for row in shown.itertuples(index=False)]
    return Table(title, [str(name) for name in shown.columns], rows)


def facts(title: str, entries: Mapping[str, Any]) -> Table:
    """A table of names and values, without those that are records themselves."""
    told = {k: v for k, v in entries.items() if not isinstance(v, Mapping | list)}
    rows = [[k, cell(v, ".4g")] for k, v in told.items()]
    return Table(title, ["", ""], rows)


def _without_nan(values: Any) -> Any:
    if isinstance(values, list):
        return [_without_nan(value) for value in values]
    return None if math.isnan(values) else values


def _caption(file: Path) -> str:
    moving = ", animated" if file.suffix == ".gif" else ""
    return file.stem.replace("_", " ") + moving


def _is_wide(file: Path) -> bool:
    """Whether a PNG has panels side by side, which are too small to read at half the width."""
    head = file.read_bytes()[:24]
    width, height = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
    return head.startswith(b"\x89PNG") and width > 2 * height


def _address(file: Path) -> str:
    coded = base64.b64encode(file.read_bytes()).decode("ascii")
    return f"data:{PICTURES[file.suffix]};base64,{coded}"
