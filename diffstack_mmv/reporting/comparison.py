"""Comparison of evaluated runs.

Dynamics x mode, mean and deviation over seeds, and a paired test.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from diffstack_mmv.reporting.files import read_json, read_parquet, told_as_broken, write_text
from diffstack_mmv.reporting.metrics_table import MISSING
from diffstack_mmv.reporting.scores import ScoreHeading, Scores
from diffstack_mmv.reporting.table import NONE, latex_table, mean_std, write_table

COMPARED = ("ade", "median_ade", "nll", "plan_ade", "planning_loss", "collision_rate", "solved")
"""Scores in the table, by name."""
SAMPLE = ["scene", "agent", "row"]
IN_EVERY_REPORT = ("ade", "nll")
"""Those of them that every report has."""
JUDGED_BY = ("smoother", "hindsight", "steadiness")
"""Settings of a report that change what its scores mean: the tracks, the planning loss, and which
way a plan takes to a known goal."""
GIVEN = ("future", "wanted")
"""The goal with which the trivial paths to it know it; those that are forecasts have an NLL."""
SETTING = ["data", "split", "goal", "mode", "vehicle"]
GROUP = [*SETTING, "dynamics"]
# private characters that no escaping touches, in place of LaTeX commands
OPEN, CLOSE = "\ue000", "\ue001"


class Comparison(NamedTuple):
    """Scores of methods side by side."""

    table: pd.DataFrame  # cells as text
    best: pd.DataFrame  # same rows, the scores' columns: whether a cell is the best of its setting


def read_runs(folders: Sequence[Path]) -> pd.DataFrame:
    """Per-mode scores of all runs, one row per run and mode; baselines count as dynamics.

    Raises:
        ValueError: No folder is given, one has no readable `metrics.json` or `samples.parquet`, two
            runs have the same seed, data, goal, mode, vehicle and dynamics, so that their mean
            would be of two settings, or they judged other windows or another smoother's.
    """
    if not folders:
        raise ValueError(
            "`runs` must name at least one folder, but got []. Give those that evaluate.py wrote."
        )
    rows: list[dict[str, Any]] = []
    baselines: list[dict[str, Any]] = []
    for folder in folders:
        with told_as_broken(folder / "metrics.json"):
            rows += _own_rows(folder)
            baselines += _baseline_rows(folder)
    _require_different_seeds(rows)
    _require_same_windows(folders)
    # runs of one seed share their baselines
    shared = [*GROUP, "seed", "ade", "plan_ade"]
    return pd.concat([pd.DataFrame(rows), pd.DataFrame(baselines).drop_duplicates(shared)])


def _own_rows(folder: Path) -> list[dict[str, Any]]:
    metrics = read_json(folder / "metrics.json")
    common = {key: metrics[key] for key in ("data", "split", "goal", "seed")} | {"run": str(folder)}
    rows: list[dict[str, Any]] = []
    for mode, scores in metrics["modes"].items():
        own = {name: scores[name] for name in ("n", MISSING, "vehicle", *IN_EVERY_REPORT)}
        # reports of plans=false have no others
        own |= {name: scores.get(name) for name in COMPARED if name not in own}
        rows.append(common | {"mode": mode, "dynamics": metrics["dynamics"]} | own)
    return rows


def _baseline_rows(folder: Path) -> list[dict[str, Any]]:
    """A trivial path is prediction and plan at once; one that is given the goal is a plan alone."""
    metrics = read_json(folder / "metrics.json")
    common = {key: metrics[key] for key in ("data", "split", "goal", "seed")} | {"run": str(folder)}
    rows = []
    for name, modes in metrics["baselines"].items():
        for mode, scores in modes.items():
            own = metrics["modes"][mode]
            predicts = metrics["goal"] not in GIVEN or f"nll_{name}" in own
            row = {"mode": mode, "dynamics": name, "n": own["n"], "vehicle": own["vehicle"]}
            row |= dict.fromkeys(("ade", "median_ade"), scores["ade"] if predicts else None)
            row |= {"plan_ade": scores["ade"] if "plan_ade" in own else None}
            rows.append(common | row)
    return rows


def _require_different_seeds(rows: Sequence[Mapping[str, Any]]) -> None:
    seen: dict[tuple[Any, ...], str] = {}
    for row in rows:
        key = tuple(row[name] for name in (*GROUP, "seed"))
        other = seen.setdefault(key, row["run"])
        if other != row["run"]:
            raise ValueError(
                "`runs` must differ in seed, data, goal, mode, vehicle or dynamics, but got "
                f"seed {row['seed']} of {row['dynamics']} in {other} and {row['run']}. "
                "Leave one of both out."
            )


class _Judged(NamedTuple):
    """What the scores of a mode in a report are of."""

    folder: Path
    settings: dict[str, Any]
    samples: pd.DataFrame  # keys, sorted


def _require_same_windows(folders: Sequence[Path]) -> None:
    """Refuse a table whose scores are of different samples: the easier ones would win."""
    seen: dict[tuple[Any, ...], _Judged] = {}
    for folder in folders:
        metrics = read_json(folder / "metrics.json")
        with told_as_broken(folder / "samples.parquet"):
            samples = read_parquet(folder / "samples.parquet")[["mode", *SAMPLE]]
        for mode, own in samples.groupby("mode"):
            keys = own[SAMPLE].sort_values(SAMPLE, ignore_index=True)
            judged = _Judged(folder, {name: metrics.get(name) for name in JUDGED_BY}, keys)
            place = (*(metrics[name] for name in ("data", "split", "goal")), mode)
            other = seen.setdefault(place, judged)
            for name, value in judged.settings.items():
                if other.settings[name] != value:
                    before, now = (_or_untold(each) for each in (other.settings[name], value))
                    told = f"{before} in {other.folder} and {now} in {folder}"
                    raise ValueError(_of_other(name, place, told))
            if not other.samples.equals(keys):
                told = f"{len(other.samples)} in {other.folder} and {len(keys)} in {folder}"
                raise ValueError(_of_other("windows", place, told))


def _or_untold(setting: Any) -> str:
    """A setting as it is told; reports of earlier versions do not tell all of them."""
    return "none told" if setting is None else str(setting)


def _of_other(what: str, place: Sequence[Any], told: str) -> str:
    where = ", ".join(map(str, place))
    remedy = (
        "Evaluate them on the same conversion with the same data.stride, history_s, dt_s and "
        "goal.steadiness, and trained with the same loss.hindsight."
    )
    return f"`runs` must have the same {what} for {where}, but got {told}. {remedy}"


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
        means.append(row | {heading: _mean(each) for heading, each in values.items()})
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
    shown = values.round(3)
    extreme = shown.min() if lower_is_better else shown.max()
    return (shown == extreme) & (values.notna().sum() > 1)


def _known(values: pd.Series) -> np.ndarray:
    numbers = values.to_numpy(np.float64)
    return numbers[~np.isnan(numbers)]


def _mean(known: np.ndarray) -> float:
    return float(known.mean()) if len(known) > 0 else float("nan")


def require_score(folders: Sequence[Path], score: str) -> None:
    """Refuse a score for the paired test that a report does not have.

    Raises:
        ValueError: It is one of plans, and a report was made without them, or of no report at all.
    """
    for folder in folders:
        for mode, told in read_json(folder / "metrics.json").get("modes", {}).items():
            if score not in told:
                raise ValueError(
                    f"`score` must be a score of every report, but got no {score} of {mode} in "
                    f"{folder}. Give score=ade, or evaluate it with plans=true."
                )


def paired_tests(folders: Sequence[Path], score: ScoreHeading) -> pd.DataFrame:
    """Wilcoxon signed-rank test between the dynamics, paired by scene.

    Windows of one scene resemble each other, so the score is averaged over those that both judged,
    and over seeds, before the test. The table says which of both has the better mean.
    """
    samples = []
    for folder in folders:
        metrics = read_json(folder / "metrics.json")
        with told_as_broken(folder / "samples.parquet"):
            frame = read_parquet(folder / "samples.parquet")[["mode", *SAMPLE, score.name]]
        frame["vehicle"] = [metrics["modes"][mode]["vehicle"] for mode in frame["mode"]]
        place = {key: metrics[key] for key in ("data", "split", "goal", "dynamics")}
        samples.append(frame.assign(**place))
    windows = (
        pd.concat(samples).groupby([*SETTING, *SAMPLE, "dynamics"])[score.name].mean().unstack()
    )
    rows = []
    for place, group in windows.groupby(level=SETTING):
        for first, second in combinations(group.columns, 2):
            both = (group[first] - group[second]).dropna()
            difference = both.groupby(level="scene").mean().to_numpy()
            row = dict(zip(SETTING, place, strict=True))
            row["pair"] = f"{first} - {second}"
            mean = _mean(difference)
            row |= {"scenes": len(difference), f"mean Δ {score.heading}": mean}
            row["better"] = _better(first, second, mean, score.lower_is_better)
            rows.append(row | {"p": signed_rank(difference)})
    return pd.DataFrame(rows)


def _better(first: str, second: str, difference: float, lower_is_better: bool) -> str:
    """Which of both a mean difference, first minus second, speaks for; a dash for neither."""
    if np.isnan(difference) or round(difference, 6) == 0:
        return NONE
    return first if (difference < 0) == lower_is_better else second


def signed_rank(difference: np.ndarray) -> float:
    """Two-sided p value of the Wilcoxon signed-rank test of differences (n,).

    NaN below six unequal pairs.
    """
    if (difference != 0).sum() < 6:
        return float("nan")
    result: Any = wilcoxon(difference)
    return float(result.pvalue)


def write_comparison(folder: Path, comparison: Comparison, tests: pd.DataFrame) -> None:
    """Write `table.md`, `table.tex` and `table.csv`, and the tests beside them as `tests.csv`.

    The best method of a setting is bold in the first two.
    """
    sections = [str(_marked(comparison, "**", "**").to_markdown(index=False))]
    if not tests.empty:
        told = "Paired by scene, Wilcoxon signed-rank (p from six unequal pairs on):"
        shown = tests.astype(object).replace(np.nan, None)
        sections += [told, str(shown.to_markdown(index=False, floatfmt=".4g", missingval=NONE))]
    latex = latex_table(_marked(comparison, OPEN, CLOSE))
    latex = latex.replace(OPEN, r"\textbf{").replace(CLOSE, "}")
    write_table(folder, "table", comparison.table, "\n\n".join(sections) + "\n", latex)
    write_text(folder / "tests.csv", str(tests.to_csv(index=False)))


def _marked(comparison: Comparison, before: str, after: str) -> pd.DataFrame:
    """The table with marks around the best cells."""
    cells = comparison.table[list(comparison.best.columns)]
    return comparison.table.assign(**(before + cells + after).where(comparison.best, cells))
