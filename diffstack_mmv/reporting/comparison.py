"""Comparison of evaluated runs: dynamics x mode, mean and deviation over seeds."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from diffstack_mmv.reporting.compared_runs import COMPARED, GROUP, IN_EVERY_REPORT, SETTING
from diffstack_mmv.reporting.files import write_text
from diffstack_mmv.reporting.metrics_table import MISSING
from diffstack_mmv.reporting.scores import Scores
from diffstack_mmv.reporting.table import (
    known_mean,
    latex_table,
    markdown_table,
    mean_std,
    write_table,
)

# private characters that no escaping touches, in place of LaTeX commands
OPEN, CLOSE = "\ue000", "\ue001"


class Comparison(NamedTuple):
    """Scores of methods side by side."""

    table: pd.DataFrame  # cells as text
    best: pd.DataFrame  # same rows, the scores' columns: whether a cell is the best of its setting


def compare(runs: pd.DataFrame, scores: Scores) -> Comparison:
    """Mean ± standard deviation over seeds of each score, by data, goal, mode and dynamics.

    Args:
        runs: What `read_runs` returned.
        scores: Titles, units and directions of the scores; those that no run has are left out.
    """
    known = [name for name in COMPARED if name in IN_EVERY_REPORT or runs[name].notna().any()]
    compared = {scores[name].heading: scores[name] for name in known}
    texts, means = [], []
    for key, group in runs.groupby(GROUP, sort=False):
        row = dict(zip(GROUP, key, strict=True))
        row |= {"seeds": group["seed"].nunique(), "n": int(group["n"].max())}
        row |= {"not judged": int(group[MISSING].fillna(0).max())}
        values = {heading: _known(group[score.name]) for heading, score in compared.items()}
        texts.append(row | {heading: mean_std(each) for heading, each in values.items()})
        means.append(row | {heading: known_mean(each) for heading, each in values.items()})
    order = {"by": ["data", "goal", "mode", "vehicle"], "kind": "stable"}
    table = pd.DataFrame(texts).sort_values(**order)
    if not table["not judged"].any():
        table = table.drop(columns="not judged")
    numbers = pd.DataFrame(means).sort_values(**order).groupby(SETTING, sort=False)
    best = {
        heading: numbers[heading].transform(_is_best, lower_is_better=score.lower_is_better)
        for heading, score in compared.items()
    }
    return Comparison(table, pd.DataFrame(best).astype(bool))


def _is_best(values: pd.Series, lower_is_better: bool) -> pd.Series:
    """Which values are the best, as far as the table shows it; none where there is no other."""
    # `round` and a table do not round every number alike: 0.0125 becomes 0.012 and "0.013"
    shown = values.map("{:.3f}".format).astype(float)
    extreme = shown.min() if lower_is_better else shown.max()
    return (shown == extreme) & (values.notna().sum() > 1)


def _known(values: pd.Series) -> np.ndarray:
    numbers = values.to_numpy(np.float64)
    return numbers[~np.isnan(numbers)]


def write_comparison(folder: Path, comparison: Comparison, tests: pd.DataFrame) -> None:
    """Write `table.md`, `table.tex` and `table.csv`, and the tests beside them as `tests.csv`.

    The best method of a setting is bold in the first two.
    """
    sections = [markdown_table(_marked(comparison, "**", "**"))]
    if not tests.empty:
        told = "Paired by recording, Wilcoxon signed-rank (p from six unequal pairs on):"
        sections += [told, markdown_table(tests, ".4g")]
    latex = latex_table(_marked(comparison, OPEN, CLOSE))
    latex = latex.replace(OPEN, r"\textbf{").replace(CLOSE, "}")
    write_table(folder, "table", comparison.table, "\n\n".join(sections) + "\n", latex)
    write_text(folder / "tests.csv", str(tests.to_csv(index=False)))


def _marked(comparison: Comparison, before: str, after: str) -> pd.DataFrame:
    """The table with marks around the best cells."""
    cells = comparison.table[list(comparison.best.columns)]
    return comparison.table.assign(**(before + cells + after).where(comparison.best, cells))
