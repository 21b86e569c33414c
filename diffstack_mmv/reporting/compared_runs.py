"""Scores of the runs that are compared, of the same windows and of different seeds."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from diffstack_mmv.reporting.files import read_json, read_parquet, told_as_broken
from diffstack_mmv.reporting.metrics_table import MISSING

COMPARED = ("ade", "median_ade", "nll", "plan_ade", "planning_loss", "collision_rate", "solved")
"""Scores in the table, by name."""
IN_EVERY_REPORT = ("ade", "nll")
"""Those of them that every report has."""
JUDGED_BY = ("smoother", "hindsight", "steadiness")
"""Settings of a report that change what its scores mean: the tracks, the planning loss, and which
way a plan takes to a known goal."""
GIVEN = ("future", "wanted")
"""The goal with which the trivial paths to it know it; those that are forecasts have an NLL."""
SAMPLE = ["scene", "agent", "row"]
RECORDING = "recording"
SETTING = ["data", "split", "goal", "mode", "vehicle"]
GROUP = [*SETTING, "dynamics"]


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
    apart = pd.DataFrame(baselines).drop_duplicates(shared).index
    return pd.DataFrame([*rows, *(baselines[number] for number in apart)])


def identity(samples: pd.DataFrame) -> list[str]:
    """Columns that tell which sample a row of `samples.parquet` is, and of which recording."""
    return ["mode", *SAMPLE, *({RECORDING} & {*samples})]


def with_recordings(samples: pd.DataFrame, within: Sequence[str] = ()) -> pd.DataFrame:
    """Samples with the recording of each, over which intervals and tests are made.

    Earlier evaluations do not tell it: there it is what another report says of the scene, or else
    the scene itself.

    Args:
        samples: Rows of one report or of several, with `scene`.
        within: Columns within which a scene has one recording, such as the data set.
    """
    if RECORDING not in samples:
        return samples.assign(**{RECORDING: samples["scene"]})
    told = samples.groupby([*within, "scene"])[RECORDING].transform("first")
    return samples.assign(**{RECORDING: told.fillna(samples["scene"])})


def is_forecast(name: str, metrics: Mapping[str, Any], mode: str) -> bool:
    """Whether a trivial path is a prediction, and not led to the goal that the human had."""
    return metrics["goal"] not in GIVEN or f"nll_{name}" in metrics["modes"][mode]


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
            predicts = is_forecast(name, metrics, mode)
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
