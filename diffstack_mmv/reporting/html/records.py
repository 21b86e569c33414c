"""The tables and numbers of a run, for whoever keeps records of many runs."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffstack_mmv.reporting.files import read_config, read_json
from diffstack_mmv.reporting.html.blocks import Gallery, Table
from diffstack_mmv.reporting.html.readers import Titles, read_page
from diffstack_mmv.reporting.table import NONE

FILES = ("metrics.json", "closed_loop.json", "identification.json")
LONG = ("cases", "baselines", "situations", "paired", "drawn_by")
"""Parts of these files that are tables, not numbers."""


class Rows(NamedTuple):
    """A table: numbers where a whole column is one, else text."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str | float | None]]


class RunRecord(NamedTuple):
    """What a run has to tell in the end."""

    config: dict[str, Any]
    tables: dict[str, Rows]
    numbers: dict[str, float]  # path in its file -> value
    pictures: dict[str, Path]


def read_record(folder: Path, titles: Titles) -> RunRecord:
    """Read the results of one run, those that its page shows.

    Args:
        folder: Its folder.
        titles: Titles and units of scores.

    Raises:
        ValueError: The folder holds no results, or a file of it is broken.
    """
    blocks = [each for section in read_page(folder, titles, 0).sections for each in section.blocks]
    tables = {each.title: _rows(each) for each in blocks if isinstance(each, Table)}
    galleries = [each for each in blocks if isinstance(each, Gallery)]
    pictures = {file.stem: file for each in galleries for file in each.files}
    config = read_config(folder)
    known = [folder / name for name in FILES if (folder / name).is_file()]
    numbers = {key: value for each in known for key, value in _numbers("", read_json(each))}
    return RunRecord(config, tables, numbers, pictures)


def _rows(table: Table) -> Rows:
    columns = [_column(list(values)) for values in zip(*table.rows, strict=True)]
    names = [name or "name" for name in table.columns]
    return Rows(names, [list(row) for row in zip(*columns, strict=True)])


def _column(cells: Sequence[str]) -> Sequence[str | float | None]:
    """Numbers if all known cells are some; a dash is unknown."""
    try:
        return [None if cell == NONE else float(cell) for cell in cells]
    except ValueError:
        return cells


def _numbers(place: str, content: Any) -> Iterator[tuple[str, float]]:
    if isinstance(content, Mapping):
        for name, value in content.items():
            if name not in LONG:
                yield from _numbers(f"{place}/{name}" if place else str(name), value)
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield place, float(content)
