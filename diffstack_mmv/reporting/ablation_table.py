"""The table of an ablation: what is changed one below the other, beside the trivial paths."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.compared_runs import is_forecast
from diffstack_mmv.reporting.prediction_table import named_apart
from diffstack_mmv.reporting.runs import Run
from diffstack_mmv.reporting.table import NONE, mean_std

SITUATIONS = ("moving", "standing")
DISTANCES = {"median_ade": "ADE of the median [m]", "moving": "moving", "standing": "standing"}
OTHERS = {
    "nll": "NLL [nats]",
    "energy_score": "energy score [m]",
    "coverage_50": "50 % region",
    "coverage_90": "90 % region",
}


def ablation_table(runs: Sequence[Run], models: Mapping[str, str]) -> pd.DataFrame:
    """One row per set and model, mean ± standard deviation over the seeds that have ended.

    The number of seeds says how many those are; all are judged on the same windows. Trivial paths,
    which have no seeds, follow; they are those of the first set.

    Args:
        runs: Evaluated runs, and such that have not ended.
        models: Name of the dynamics -> title, in order; with one model it is not named.
    """
    rows, trivial, name_of = [], {}, named_apart(runs)
    for data, mode, model in dict.fromkeys((run.data, run.mode, run.model) for run in runs):
        own = [run for run in runs if (run.data, run.mode, run.model) == (data, mode, model)]
        told = [run.read() for run in own if run.ended]
        name = name_of(own[0]) if len(models) == 1 else f"{name_of(own[0])}, {models[model]}"
        seeds = f"{len(told)} of {len(own)}"
        windows = str(told[0]["modes"][mode]["n"]) if told else NONE
        rows.append(
            {"": name, "seeds": seeds, "windows": windows}
            | _cells([_scores(each, mode) for each in told])
        )
        if told and not trivial:
            trivial = _trivial(told[0], mode)
    rows += [
        {"": name.replace("_", " "), "seeds": NONE, "windows": NONE} | _cells([scores])
        for name, scores in trivial.items()
    ]
    return pd.DataFrame(rows)


def _scores(told: Any, mode: str) -> dict[str, float | None]:
    own, situations = told["modes"][mode], _situations(told, mode)
    return {
        **{name: own[name] for name in ("median_ade", *OTHERS)},
        **{name: scores["median_ade"] for name, scores in situations.items()},
    }


def _situations(told: Any, mode: str) -> dict[str, Any]:
    """Scores of those who move and of those who stand; either may be nobody."""
    there = told["situations"][mode]
    return {name: there[name] for name in SITUATIONS if name in there}


def _trivial(told: Any, mode: str) -> dict[str, dict[str, float | None]]:
    """Distances of each trivial path, and its NLL; none of one that is led to the human's goal."""
    found = {}
    for name, per_mode in told["baselines"].items():
        if not is_forecast(name, told, mode):
            continue
        situations = {
            situation: scores["baselines"][name]["ade"]
            for situation, scores in _situations(told, mode).items()
        }
        likelihood = told["modes"][mode].get(f"nll_{name}")
        found[name] = {"median_ade": per_mode[mode]["ade"], **situations}
        if likelihood is not None:
            found[name]["nll"] = likelihood
    return found


def _cells(scores: Sequence[Mapping[str, float | None]]) -> dict[str, str]:
    """Cells by their headings; a score that could judge no sample is None, and no part of one."""
    return {
        heading: mean_std([value for each in scores if (value := each.get(name)) is not None])
        for name, heading in (DISTANCES | OTHERS).items()
    }
