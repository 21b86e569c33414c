"""What all tables share: how a value is told, and the three files of a table."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from diffstack_mmv.reporting.files import write_text

NONE = "–"
"""In place of a value that is not there."""


def cell(value: Any, form: str = ".3f") -> str:
    """A value as text: a dash where it is not known, a number with a fraction in this form."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NONE
    if isinstance(value, float | np.floating):
        return format(value, form)
    return str(value)


def known_mean(known: Float[np.ndarray, " n"]) -> float:
    """Mean of the known values; NaN of none."""
    return float(known.mean()) if len(known) > 0 else float("nan")


def mean_std(values: Sequence[float] | np.ndarray) -> str:
    """Mean ± standard deviation, without the latter of a single value; a dash for none (n,)."""
    if len(values) == 0:
        return NONE
    mean = f"{np.mean(values):.3f}"
    return f"{mean} ± {np.std(values, ddof=1):.3f}" if len(values) > 1 else mean


def with_interval(value: float | None, interval: Sequence[float]) -> str:
    """A number with the low and the high end of its interval."""
    low, high = interval
    return f"{cell(value)} [{low:.3f}, {high:.3f}]"


def write_table(folder: Path, name: str, table: pd.DataFrame, text: str, latex: str = "") -> None:
    """Write `NAME.md`, `NAME.tex` and `NAME.csv`.

    Args:
        folder: Where.
        name: Of the files.
        table: For LaTeX and CSV.
        text: What the Markdown file holds.
        latex: What the LaTeX file holds, by default the table as it is.
    """
    write_text(folder / f"{name}.md", text)
    write_text(folder / f"{name}.tex", latex or latex_table(table))
    write_text(folder / f"{name}.csv", str(table.to_csv(index=False)))


def markdown_table(table: pd.DataFrame, form: str = ".3f", index: bool = False) -> str:
    """A table for Markdown: numbers in this form, text as it is (0.410 would become 0.41)."""
    told = table.map(partial(cell, form=form))
    return str(told.to_markdown(index=index, disable_numparse=True))


def latex_table(table: pd.DataFrame) -> str:
    """A table for LaTeX; what LaTeX would take for a command is escaped."""
    return str(table.to_latex(index=False, escape=True))
