"""Files of recorded controls: one row per control step, read and checked as a whole."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require

COLUMNS = ("acceleration_mps2", "steer_rad")


def read_controls(path: Path, dt_s: float) -> Float[Tensor, "T 2"]:
    """Accelerations in m/s² and steering angles in rad, row by row.

    Args:
        path: A CSV file with the columns `acceleration_mps2` and `steer_rad`.
        dt_s: The step in s that a column `time_s` must have where there is one.

    Raises:
        ValueError: The file is missing, lacks a column, is empty, or holds something else.
    """
    where, remedy = f"in {path}", "Write one row per control step."
    rows = _read_rows(path, where)
    require(len(rows) > 0, "controls", "hold at least one row", 0, where, remedy)
    values = _numbers(rows, COLUMNS, where)
    bad = (~torch.isfinite(values).all(1)).nonzero().flatten().tolist()
    told = f"{values[bad[0]].tolist()} in row {bad[0] + 1}" if bad else ""
    require(not bad, "controls", "hold finite numbers", told, where, remedy)
    steep = values[:, 1].abs().max().item()
    requirement = "stay below π/2 in the column steer_rad"
    require(steep < math.pi / 2, "controls", requirement, steep, where, "Give radians.")
    if "time_s" in rows[0]:
        _require_steps(_numbers(rows, ("time_s",), where)[:, 0], dt_s, where)
    return values


def _read_rows(path: Path, where: str) -> list[dict[str, str]]:
    """Rows of a CSV file, by the names of their columns.

    A byte-order mark, and blanks around names and numbers, are left out: spreadsheets write them.
    """
    wanted = f"be a CSV file of numbers with the columns {', '.join(COLUMNS)}"
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream, strict=True, skipinitialspace=True)
            names = [name.strip() for name in reader.fieldnames or ()]
            reader.fieldnames = names
            rows = list(reader)
    except (OSError, ValueError, csv.Error) as problem:
        raise ValueError(message("controls", wanted, f"{path} ({problem})")) from problem
    lacking = [name for name in COLUMNS if name not in names]
    told = f"the columns {', '.join(names)}" if names else "an empty file"
    remedy = "Name them in the first row, between commas."
    require(not lacking, "controls", wanted, told, where, remedy)
    ragged = [number for number, row in enumerate(rows, 1) if None in row]
    told = f"more in row {ragged[0]}" if ragged else ""
    require(not ragged, "controls", "have as many values in a row as names", told, where)
    return rows


def _numbers(
    rows: Sequence[Mapping[str, str]], columns: Sequence[str], where: str
) -> Float[Tensor, "T k"]:
    values = []
    for number, row in enumerate(rows, 1):
        for name in columns:
            try:
                values.append(float(row[name]))
            except (TypeError, ValueError) as problem:
                told = f"{row[name]!r} in row {number}, column {name},"
                raise ValueError(message("controls", "hold numbers", told, where)) from problem
    return torch.tensor(values, dtype=torch.float64).reshape(len(rows), len(columns))


def _require_steps(times: Float[Tensor, " T"], dt_s: float, where: str) -> None:
    """Refuse controls of another rate, which would be driven too fast or too slowly."""
    steps = times.diff()
    bad = ((steps - dt_s).abs() < 0.01 * dt_s).logical_not().nonzero().flatten().tolist()
    told = f"{steps[bad[0]].item():g} s before row {bad[0] + 2}" if bad else ""
    requirement = f"have steps of {dt_s:g} s in the column time_s"
    remedy = "Set dt_s to the step of the file, or resample it."
    require(not bad, "controls", requirement, told, where, remedy)
