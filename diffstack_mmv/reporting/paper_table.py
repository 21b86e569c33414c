"""The table of the paper: scores per mode and model, over seeds, beside the trivial paths."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from diffstack_mmv.reporting.bootstrapping import bootstrap
from diffstack_mmv.reporting.compared_runs import (
    RECORDING,
    SAMPLE,
    is_forecast,
    with_recordings,
)
from diffstack_mmv.reporting.files import read_parquet
from diffstack_mmv.reporting.runs import Run
from diffstack_mmv.reporting.scores import ScoreHeading, Scores
from diffstack_mmv.reporting.table import NONE, cell, markdown_table, with_interval, write_table

SHOWN = (
    "ade",
    "nll",
    "plan_ade",
    "planning_loss",
    "collision_rate",
    "human_collision_rate",
    "solved",
)
LOGARITHMIC = "nats"
"""Unit of scores with no zero of their own, whose differences mean something and shares do not."""


def paper_table(
    runs: Sequence[Run], models: Mapping[str, str], scores: Scores, resamples: int = 1000
) -> pd.DataFrame:
    """One row per data set, goal, mode and model; the others are compared with the first model.

    A cell is `mean [low, high] (± deviation over seeds, difference)`, with the interval of
    `bootstrap`; differences are in %, in nats where that is the unit, and absent while the first
    model has not ended. Trivial paths follow the models; one that is led to a given goal is a plan
    alone. A run that has not ended is told, never averaged.

    Args:
        runs: All runs that the table is about.
        models: Name of the dynamics -> title, in order.
        scores: Titles, units and directions.
        resamples: Draws of the bootstrap.
    """
    rows: list[dict[str, Any]] = []
    reference = next(iter(models), None)
    keys = dict.fromkeys((run.data, run.goal, run.mode) for run in runs)
    for data, goal, mode in keys:
        first: dict[str, float] = {}
        place = {"data": data, "goal": goal, "mode": mode}
        trivial: dict[str, dict[str, str]] = {}
        for model, title in models.items():
            own = [run for run in runs if (run.place, run.model) == ((data, mode, goal), model)]
            ended = [run for run in own if run.ended]
            row: dict[str, Any] = place | {"model": title, "seeds": f"{len(ended)}/{len(own)}"}
            if not ended:
                rows.append(row | {"n": NONE})
                continue
            told = [run.read() for run in ended]
            samples = _over_seeds(ended, mode)
            row["n"] = str(len(samples))
            for name in SHOWN:
                means = [part["modes"][mode][name] for part in told]
                interval = bootstrap(samples[name], samples[RECORDING], resamples)
                row[scores[name].heading] = _cell(means, interval, first.get(name), scores[name])
                if model == reference:
                    first[name] = _mean(means)
            trivial |= _trivial(told[0], mode, scores)
            rows.append(row)
        for name, cells in trivial.items():
            rows.append(place | {"model": name.replace("_", " "), "seeds": NONE, "n": NONE} | cells)
    return pd.DataFrame(rows).fillna(NONE)


def write_paper_table(folder: Path, table: pd.DataFrame, remarks: Sequence[str]) -> None:
    """Write `results.md`, `results.tex` and `results.csv`; remarks go below the first."""
    text = markdown_table(table) if len(table) else "No run has ended."
    below = "\n".join(f"- {remark}" for remark in remarks)
    whole = f"{text}\n\n{below}\n" if below else f"{text}\n"
    write_table(folder, "results", table, whole)


def _trivial(told: Mapping[str, Any], mode: str, scores: Scores) -> dict[str, dict[str, str]]:
    """Cells of each trivial path: a plan, and a prediction unless it is led to the goal."""
    cells = {}
    for name, per_mode in told["baselines"].items():
        known = ("ade", "plan_ade") if is_forecast(name, told, mode) else ("plan_ade",)
        error = cell(per_mode[mode]["ade"])
        cells[name] = {scores[score].heading: error for score in known}
    return cells


def _over_seeds(runs: Sequence[Run], mode: str) -> pd.DataFrame:
    """Scores of each sample of a mode, averaged over seeds; NaN where a seed could not judge it.

    Raises:
        ValueError: The seeds were judged on different samples.
    """
    frames = [read_parquet(run.report / "samples.parquet") for run in runs]
    own = [frame[frame["mode"] == mode].sort_values(SAMPLE, ignore_index=True) for frame in frames]
    for run, frame in zip(runs, own, strict=True):
        if not frame[SAMPLE].equals(own[0][SAMPLE]):
            raise ValueError(
                f"{run.report} and {runs[0].report} were judged on different windows of {mode} "
                f"({len(frame)} and {len(own[0])}). Evaluate them on the same conversion."
            )
    mean = np.mean([frame[list(SHOWN)].to_numpy(np.float64) for frame in own], 0)
    recordings = with_recordings(pd.concat(own, ignore_index=True))[RECORDING][: len(mean)]
    return pd.DataFrame(mean, columns=list(SHOWN)).assign(**{RECORDING: recordings})


def _mean(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")


def _cell(
    values: Sequence[float | None],
    interval: tuple[float, float],
    first: float | None,
    score: ScoreHeading,
) -> str:
    """A score as text."""
    known = [value for value in values if value is not None]
    if not known:
        return NONE
    mean, notes = float(np.mean(known)), []
    if len(known) > 1:
        notes.append(f"± {np.std(known, ddof=1):.3f}")
    if first is not None and np.isfinite(first):
        if score.unit == LOGARITHMIC:
            notes.append(f"{mean - first:+.3f}")
        elif first != 0:
            notes.append(f"{100 * (mean - first) / first:+.1f} %")
    # values that are all the same tell nothing of how they spread
    text = with_interval(mean, interval) if interval[0] < interval[1] else cell(mean)
    return text + (f" ({', '.join(notes)})" if notes else "")
