"""The table of a benchmark of predictions: ADE / FDE per data set and on average."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from diffstack_mmv.reporting.compared_runs import is_forecast
from diffstack_mmv.reporting.runs import Run
from diffstack_mmv.reporting.table import NONE

METHODS: Mapping[str, tuple[str, str]] = {
    "one path (median)": ("median_ade", "median_fde"),
    "one path (mean)": ("mean_ade", "mean_fde"),
    "one path (combined)": ("combined_ade", "combined_fde"),
    "most likely path": ("ade", "fde"),
    "best of 20 paths": ("best_of_20_ade", "best_of_20_fde"),
    "best of 20 spread paths": ("best_of_20_spread_ade", "best_of_20_spread_fde"),
}
"""Rows of each model: what they are called, and the scores in them."""
HEADING, MEAN = "method, ADE / FDE [m]", "mean"


def prediction_table(runs: Sequence[Run], models: Mapping[str, str]) -> pd.DataFrame:
    """One row per method, one column `ADE / FDE` in m per data set (and mode), and their mean.

    Several seeds are averaged. A data set in which a run is missing has a dash; so has the mean.
    Trivial paths that are led to the goal of the human are no predictions, and left out.

    Args:
        runs: Evaluated runs; those that have not ended are told by dashes.
        models: Name of the dynamics -> title, in order.
    """
    name_of = named_apart(runs)
    names = list(dict.fromkeys(name_of(run) for run in runs))
    rows: dict[str, dict[str, np.ndarray]] = {}
    for run in runs:
        told = run.read() if run.ended else None
        for method, value in _values(run, told, models).items():
            known = rows.setdefault(method, {}).get(name_of(run))
            both = value[None] if known is None else np.concatenate([known, value[None]])
            rows[method][name_of(run)] = both
    table = []
    for method, per_set in rows.items():
        row: dict[str, Any] = {HEADING: method}
        means = {name: per_set[name].mean(0) for name in names if name in per_set}
        row |= {name: _pair(means.get(name, np.full(2, np.nan))) for name in names}
        complete = len(means) == len(names)
        row[MEAN] = _pair(np.mean(list(means.values()), 0) if complete else np.full(2, np.nan))
        table.append(row)
    return pd.DataFrame(table)


def named_apart(runs: Sequence[Run]) -> Callable[[Run], str]:
    """What the data of a run are called: with the mode where a set has several."""
    modes: dict[str, set[str]] = {}
    for run in runs:
        modes.setdefault(run.data, set()).add(run.mode)
    return lambda run: f"{run.data}, {run.mode}" if len(modes[run.data]) > 1 else run.data


def _values(run: Run, told: Any, models: Mapping[str, str]) -> dict[str, np.ndarray]:
    """ADE and FDE of each method of a run, NaN for what an earlier version did not score.

    All are NaN where the run has not ended.
    """
    titles = {method: f"{models[run.model]}, {method}" for method in METHODS}
    if told is None:
        return dict.fromkeys(titles.values(), np.full(2, np.nan))
    own = told["modes"][run.mode]
    values = {
        titles[method]: np.array([own.get(name) for name in names], np.float64)
        for method, names in METHODS.items()
    }
    for name, per_mode in told["baselines"].items():
        if is_forecast(name, told, run.mode):
            trivial = [per_mode[run.mode][score] for score in ("ade", "fde")]
            values[name.replace("_", " ")] = np.array(trivial, np.float64)
    return values


def _pair(values: np.ndarray) -> str:
    return NONE if np.isnan(values).any() else " / ".join(f"{value:.2f}" for value in values)
