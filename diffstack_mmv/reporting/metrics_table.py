"""`metrics.json`, `metrics.csv` and `metrics.md` from a table of per-sample scores."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from diffstack_mmv.reporting.files import write_json, write_text
from diffstack_mmv.reporting.scores import Scores
from diffstack_mmv.reporting.table import cell

BASELINE_SCORES = ("ade", "fde")
"""Scores that it holds for every baseline."""
MEDIAN = "prediction (median)"
OWN_PATHS = {
    "prediction (most likely)": "",
    MEDIAN: "median_",
    "prediction (mean)": "mean_",
    "prediction (combined)": "combined_",
    "plan": "plan_",
}
"""Paths of a stack, and what the names of their scores begin with."""
MISSING = "n_missing"
COST = "cost/"
"""What the columns of the cost of a plan by term begin with."""


def baseline_names(samples: pd.DataFrame) -> list[str]:
    """Names of the baselines in a table of samples, in order."""
    return [name.removesuffix("/ade") for name in samples.columns if name.endswith("/ade")]


def summarise(samples: pd.DataFrame, scores: Scores) -> dict[str, Any]:
    """Numbers of samples, and of those that a score could not judge; means over the others.

    A score that could judge no sample at all is None.
    """
    names = list(scores)
    missing = int(samples[names].isna().any(axis=1).sum())
    return {"n": len(samples), MISSING: missing} | {name: _mean(samples[name]) for name in names}


def summarise_baselines(samples: pd.DataFrame) -> dict[str, dict[str, float | None]]:
    """Mean ADE and FDE in m of every baseline over some samples."""
    return {
        name: {score: _mean(samples[f"{name}/{score}"]) for score in BASELINE_SCORES}
        for name in baseline_names(samples)
    }


def _mean(values: pd.Series) -> float | None:
    """Mean over the judged samples, for JSON, which knows no NaN."""
    mean = float(values.mean())
    return None if np.isnan(mean) else mean


def summarise_modes(
    samples: pd.DataFrame, situations: Sequence[str], vehicle: str, scores: Scores
) -> dict[str, Any]:
    """The parts of `metrics.json` by mode, without empty groups.

    Args:
        samples: One row per sample: `mode`, the scores, `BASELINE/ade`, `BASELINE/fde`, and one
            column of truth values per situation.
        situations: Names of those columns.
        vehicle: Name of the vehicle that planned.
        scores: Registry of the scores, all of which `metrics.json` holds for every mode.
    """
    modes: dict[str, Any] = {}
    baselines: dict[str, dict[str, Any]] = {name: {} for name in baseline_names(samples)}
    by_situation: dict[str, dict[str, Any]] = {}
    costs: dict[str, dict[str, float | None]] = {}
    terms = [name for name in samples.columns if name.startswith(COST)]
    for mode, group in samples.groupby("mode", sort=True):
        likelihoods = {
            f"nll_{name.removesuffix('/nll')}": _mean(group[name])
            for name in samples.columns
            if name.endswith("/nll")
        }
        modes[str(mode)] = {"vehicle": vehicle} | summarise(group, scores) | likelihoods
        costs[str(mode)] = {name.removeprefix(COST): _mean(group[name]) for name in terms}
        for name, told in summarise_baselines(group).items():
            baselines[name][str(mode)] = told
        by_situation[str(mode)] = {
            situation: summarise(group.loc[group[situation]], scores)
            | {"baselines": summarise_baselines(group.loc[group[situation]])}
            for situation in situations
            if group[situation].any()
        }
    return {"modes": modes, "baselines": baselines, "costs": costs, "situations": by_situation}


def mode_table(metrics: Mapping[str, Any], scores: Scores) -> pd.DataFrame:
    """One row per mode with all scores; a column counts samples not judged, if there are any."""
    headings = {name: score.heading for name, score in scores.items()}
    rows = {
        mode: {"vehicle": told["vehicle"], "n": str(told["n"]), "not judged": str(told[MISSING])}
        | {heading: told[name] for name, heading in headings.items()}
        for mode, told in metrics["modes"].items()
    }
    frame = pd.DataFrame.from_dict(rows, orient="index")
    frame.index.name = "mode"
    missing = any(told[MISSING] for told in metrics["modes"].values())
    return frame if missing else frame.drop(columns="not judged")


def baseline_table(metrics: Mapping[str, Any], scores: Scores) -> pd.DataFrame:
    """ADE and FDE of stack and baselines, one row each, one pair of columns per mode."""
    titles = {name: scores[name].title for name in BASELINE_SCORES}
    rows: dict[str, dict[str, float]] = {
        path: {
            f"{mode} {title}": told[prefix + name]
            for mode, told in metrics["modes"].items()
            for name, title in titles.items()
            if prefix + name in told
        }
        for path, prefix in OWN_PATHS.items()
    }
    for method, per_mode in metrics["baselines"].items():
        rows[method.replace("_", " ")] = {
            f"{mode} {title}": told[name]
            for mode, told in per_mode.items()
            for name, title in titles.items()
        }
    planned = {method: told for method, told in rows.items() if told}
    frame = pd.DataFrame.from_dict(planned, orient="index")
    frame.index.name = "method"
    return frame


def cost_table(metrics: Mapping[str, Any]) -> pd.DataFrame:
    """Mean cost of the plans in hindsight by mode and term."""
    frame = pd.DataFrame.from_dict(metrics["costs"], orient="index")
    frame.index.name = "mode"
    return frame


def situation_table(metrics: Mapping[str, Any]) -> pd.DataFrame:
    """ADE of stack and baselines by mode and situation."""
    rows = []
    for mode, situations in metrics["situations"].items():
        for situation, told in situations.items():
            row = {"mode": mode, "situation": situation, "n": told["n"]}
            row |= {MEDIAN: told["median_ade"]}
            row |= {"plan": told["plan_ade"]} if "plan_ade" in told else {}
            trivial = told["baselines"].items()
            rows.append(row | {name.replace("_", " "): value["ade"] for name, value in trivial})
    return pd.DataFrame(rows)


def write_metrics(folder: Path, metrics: Mapping[str, Any], scores: Scores) -> None:
    """Write `metrics.csv`, `metrics.md` and `metrics.json` into a folder.

    The last one is there as soon as all of them are: tables of many runs go by it.

    Args:
        folder: The folder.
        metrics: Header and what `summarise_modes` returned.
        scores: Titles and units of the scores.

    Raises:
        ValueError: A number is NaN or infinite.
    """
    write_text(folder / "metrics.csv", mode_table(metrics, scores).to_csv())
    write_text(folder / "metrics.md", _markdown(metrics, scores))
    write_json(folder / "metrics.json", metrics)


def _markdown(metrics: Mapping[str, Any], scores: Scores) -> str:
    told = {
        "future": "given (the human's position at the horizon)",
        "wanted": "given as a wish (the human's position at the horizon)",
        "predicted": "predicted (no future used)",
    }
    title = (
        f"# {metrics['dynamics']} · {metrics['vehicle']} · {metrics['data']}/{metrics['split']}\n\n"
        f"Goal: {told.get(metrics['goal'], metrics['goal'])}. Seed {metrics['seed']}. "
        f"Smoother: {metrics.get('smoother', 'unknown')}.{_borrowed(metrics)}\n\n"
    )
    ade, fde = (scores[name] for name in BASELINE_SCORES)
    beside = f"Beside the trivial baselines ({ade.title} and {fde.title} in {ade.unit})"
    # a row per score: some thirty columns would not fit a terminal
    by_mode = mode_table(metrics, scores).T.rename_axis("score")
    sections = (
        ("Scores by mode", by_mode, True),
        (beside, baseline_table(metrics, scores), True),
        ("Cost of the plan in hindsight by term", cost_table(metrics), True),
        (f"{ade.title} in {ade.unit} by situation", situation_table(metrics), False),
    )
    body = "\n\n".join(
        f"## {name}\n\n{_table(frame, index)}"
        for name, frame, index in sections
        if len(frame.columns)
    )
    return title + body + "\n"


def _borrowed(metrics: Mapping[str, Any]) -> str:
    """The sentence that tells who is driven with a vehicle of another mode, "" where nobody is."""
    told = metrics.get("modes_of_other_vehicles", ())
    others = [mode for mode in metrics["modes"] if mode in map(str.lower, told)]
    vehicle = f"are driven with the vehicle {metrics['vehicle']}"
    return f" Agents of mode {' and '.join(others)} {vehicle}." if others else ""


def _table(frame: pd.DataFrame, index: bool) -> str:
    """Markdown with three digits, and a dash where no sample could be judged."""
    return frame.map(cell).to_markdown(floatfmt=".3f", index=index)
