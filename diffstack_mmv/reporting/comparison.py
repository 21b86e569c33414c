"""Comparison of evaluated runs.

Dynamics x mode, mean and deviation over seeds, and a paired test.
"""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from diffstack_mmv.reporting.files import read_json, read_parquet, write_text

COMPARED = {
    "ade": "ADE [m]",
    "nll": "NLL [nats]",
    "plan_ade": "plan ADE [m]",
    "planning_loss": "planning loss",
    "collision_rate": "collisions",
    "solved": "solved",
}
GROUP = ["data", "split", "goal", "mode", "dynamics"]


def read_runs(folders: Sequence[Path]) -> pd.DataFrame:
    """Per-mode scores of all runs, one row per run and mode; baselines count as dynamics.

    Raises:
        ValueError: No folder is given, or one has no readable `metrics.json`.
    """
    if not folders:
        raise ValueError(
            "`runs` must name at least one folder, but got []. Give those that evaluate.py wrote."
        )
    rows: list[dict[str, Any]] = []
    for folder in folders:
        metrics = read_json(folder / "metrics.json")
        common = {key: metrics[key] for key in ("data", "split", "goal", "seed")} | {
            "run": str(folder)
        }
        for mode, scores in metrics["modes"].items():
            own = {name: scores[name] for name in ("n", *COMPARED)}
            rows.append(common | {"mode": mode, "dynamics": metrics["dynamics"]} | own)
        for name, modes in metrics["baselines"].items():
            for mode, scores in modes.items():
                row = {"mode": mode, "dynamics": name, "n": metrics["modes"][mode]["n"]}
                rows.append(common | row | {"ade": scores["ade"]})
    # runs of one seed share their baselines
    return pd.DataFrame(rows).drop_duplicates([*GROUP, "seed", "ade"])


def compare(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean ± standard deviation over seeds of each score, by data, goal, mode and dynamics."""
    rows = []
    for key, group in runs.groupby(GROUP, sort=False):
        row = dict(zip(GROUP, key, strict=True))
        row |= {"seeds": group["seed"].nunique(), "n": int(group["n"].max())}
        rows.append(row | {title: _spread(group[name]) for name, title in COMPARED.items()})
    return pd.DataFrame(rows).sort_values(["data", "goal", "mode"], kind="stable")


def _spread(values: pd.Series) -> str:
    numbers = values.to_numpy(np.float64)
    known = numbers[~np.isnan(numbers)]
    if len(known) == 0:
        return "-"
    return f"{known.mean():.3f}" + (f" ± {known.std(ddof=1):.3f}" if len(known) > 1 else "")


def paired_tests(folders: Sequence[Path], score: str = "plan_ade") -> pd.DataFrame:
    """Wilcoxon signed-rank test between the dynamics, paired by scene.

    Windows of one scene resemble each other, so a score (m) is averaged over them, and over seeds,
    before the test.
    """
    samples = []
    for folder in folders:
        metrics = read_json(folder / "metrics.json")
        frame = read_parquet(folder / "samples.parquet")[["scene", "mode", score]]
        samples.append(frame.assign(**{key: metrics[key] for key in ("data", "goal", "dynamics")}))
    scenes = (
        pd.concat(samples)
        .groupby(["data", "goal", "mode", "scene", "dynamics"])[score]
        .mean()
        .unstack()
    )
    rows = []
    for (data, goal, mode), group in scenes.groupby(level=[0, 1, 2]):
        for first, second in combinations(group.columns, 2):
            difference = group[first].to_numpy() - group[second].to_numpy()
            difference = difference[~np.isnan(difference)]
            row = {"data": data, "goal": goal, "mode": mode, "pair": f"{first} - {second}"}
            row |= {"scenes": len(difference), f"mean {score}": difference.mean()}
            rows.append(row | {"p": signed_rank(difference)})
    return pd.DataFrame(rows)


def signed_rank(difference: np.ndarray) -> float:
    """Two-sided p value of the Wilcoxon signed-rank test; NaN below six unequal pairs."""
    if (difference != 0).sum() < 6:
        return float("nan")
    result: Any = wilcoxon(difference)
    return float(result.pvalue)


def write_comparison(folder: Path, table: pd.DataFrame, tests: pd.DataFrame) -> None:
    """Write `table.md`, `table.tex` and `table.csv`, and the tests beside them as `tests.csv`."""
    sections = [str(table.to_markdown(index=False))]
    if not tests.empty:
        told = "Paired by scene, Wilcoxon signed-rank:"
        sections += [told, str(tests.to_markdown(index=False, floatfmt=".4g"))]
    write_text(folder / "table.md", "\n\n".join(sections) + "\n")
    write_text(folder / "table.tex", str(table.to_latex(index=False, escape=True)))
    write_text(folder / "table.csv", str(table.to_csv(index=False)))
    write_text(folder / "tests.csv", str(tests.to_csv(index=False)))
