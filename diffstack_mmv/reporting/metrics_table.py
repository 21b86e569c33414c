"""`metrics.json`, `metrics.csv` and `metrics.md` from a table of per-sample scores."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.files import write_json, write_text

MODE_SCORES = {
    "ade": "ADE [m]",
    "fde": "FDE [m]",
    "nll": "NLL [nats]",
    "plan_ade": "plan ADE [m]",
    "plan_fde": "plan FDE [m]",
    "planning_loss": "planning loss",
    "planning_ce": "CE [nats]",
    "planning_cost": "cost",
    "collision_rate": "collisions",
    "solved": "solved",
}


def baseline_names(samples: pd.DataFrame) -> list[str]:
    """Names of the baselines in a table of samples, in order."""
    return [name.removesuffix("/ade") for name in samples.columns if name.endswith("/ade")]


def summarise(samples: pd.DataFrame) -> dict[str, Any]:
    """Means of all scores over some samples."""
    means = {"n": len(samples)}
    return means | {name: float(samples[name].mean()) for name in MODE_SCORES}


def summarise_baselines(samples: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Mean ADE and FDE in m of every baseline over some samples."""
    return {
        name: {score: float(samples[f"{name}/{score}"].mean()) for score in ("ade", "fde")}
        for name in baseline_names(samples)
    }


def summarise_modes(samples: pd.DataFrame, situations: Sequence[str]) -> dict[str, Any]:
    """The parts `modes`, `baselines` and `situations` of `metrics.json`, without empty groups.

    Args:
        samples: One row per sample: `mode`, the scores, `BASELINE/ade`, `BASELINE/fde`, and one
            column of truth values per situation.
        situations: Names of those columns.
    """
    modes: dict[str, Any] = {}
    baselines: dict[str, dict[str, Any]] = {name: {} for name in baseline_names(samples)}
    by_situation: dict[str, dict[str, Any]] = {}
    for mode, group in samples.groupby("mode", sort=True):
        modes[str(mode)] = summarise(group)
        for name, scores in summarise_baselines(group).items():
            baselines[name][str(mode)] = scores
        by_situation[str(mode)] = {
            situation: summarise(group.loc[group[situation]])
            | {"baselines": summarise_baselines(group.loc[group[situation]])}
            for situation in situations
            if group[situation].any()
        }
    return {"modes": modes, "baselines": baselines, "situations": by_situation}


def mode_table(metrics: Mapping[str, Any]) -> pd.DataFrame:
    """One row per mode with all scores."""
    frame = pd.DataFrame.from_dict(metrics["modes"], orient="index")
    frame.index.name = "mode"
    return frame.astype({"n": int}).astype({"n": str}).rename(columns=MODE_SCORES)


def baseline_table(metrics: Mapping[str, Any]) -> pd.DataFrame:
    """ADE and FDE in m of stack and baselines, one row each, one pair of columns per mode."""
    rows: dict[str, dict[str, float]] = {"prediction": {}, "plan": {}}
    for mode, scores in metrics["modes"].items():
        rows["prediction"] |= {f"{mode} ADE": scores["ade"], f"{mode} FDE": scores["fde"]}
        rows["plan"] |= {f"{mode} ADE": scores["plan_ade"], f"{mode} FDE": scores["plan_fde"]}
    for name, per_mode in metrics["baselines"].items():
        rows[name] = {}
        for mode, scores in per_mode.items():
            rows[name] |= {f"{mode} ADE": scores["ade"], f"{mode} FDE": scores["fde"]}
    frame = pd.DataFrame.from_dict(rows, orient="index")
    frame.index.name = "method"
    return frame


def situation_table(metrics: Mapping[str, Any]) -> pd.DataFrame:
    """ADE in m of stack and baselines by mode and situation."""
    rows = []
    for mode, situations in metrics["situations"].items():
        for situation, scores in situations.items():
            row = {"mode": mode, "situation": situation, "n": scores["n"]}
            row |= {"prediction": scores["ade"], "plan": scores["plan_ade"]}
            rows.append(row | {name: value["ade"] for name, value in scores["baselines"].items()})
    return pd.DataFrame(rows)


def write_metrics(folder: Path, metrics: Mapping[str, Any]) -> None:
    """Write `metrics.json`, `metrics.csv` and `metrics.md` into a folder."""
    write_json(folder / "metrics.json", metrics)
    write_text(folder / "metrics.csv", mode_table(metrics).to_csv())
    write_text(folder / "metrics.md", _markdown(metrics))


def _markdown(metrics: Mapping[str, Any]) -> str:
    told = {
        "future": "given (the human's position at the horizon)",
        "predicted": "predicted (no future used)",
    }
    title = (
        f"# {metrics['dynamics']} · {metrics['vehicle']} · {metrics['data']}/{metrics['split']}\n\n"
        f"Goal: {told.get(metrics['goal'], metrics['goal'])}. Seed {metrics['seed']}. "
        f"Smoother: {metrics.get('smoother', 'unknown')}.\n\n"
    )
    sections = (
        ("Scores by mode", mode_table(metrics), True),
        ("Beside the trivial baselines (ADE and FDE in m)", baseline_table(metrics), True),
        ("ADE in m by situation", situation_table(metrics), False),
    )
    body = "\n\n".join(
        f"## {name}\n\n{frame.to_markdown(floatfmt='.3f', index=index)}"
        for name, frame, index in sections
    )
    return title + body + "\n"
