"""Scores of one batch: of the stack, and of the trivial answers beside it."""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.metrics import (
    best_of_samples,
    displacement_curve,
    displacements,
    energy_score,
    negative_log_likelihood,
    where_known,
)
from diffstack_mmv.prediction import Baseline, PredictedPath, ego_forecast
from diffstack_mmv.stack.module import DiffStackMMV
from diffstack_mmv.stack.scores import prediction_scores
from diffstack_mmv.types import Forecast, StackBatch, Tracks

COST = "cost/"
"""Prefix of the columns that hold the cost of a plan by term."""


class Judged(NamedTuple):
    """Scores and paths of the stack, and the goal that baselines are given."""

    scores: dict[str, Tensor]
    paths: dict[str, Tensor]
    goal: Float[Tensor, "B 2"]
    forecast: Forecast  # of the ego


@torch.no_grad()
def judged_plans(stack: DiffStackMMV, batch: StackBatch, first: int, seed: int = 0) -> Judged:
    """What a stack predicts and plans for a batch.

    Args:
        stack: The stack.
        batch: The samples.
        first: Number of the first one.
        seed: Of the paths that are drawn for scores; with the number it decides on them.
    """
    output = stack(batch)
    terms = stack.hindsight_costs(batch, output)
    ego = ego_forecast(output.forecast)
    further = _further_scores(ego, batch.ego_future, first, seed)
    scores = stack.score(batch, output, terms) | further
    scores |= {f"{COST}{term}": cost for term, cost in terms.items()}
    paths = {"prediction": ego.median(), "plan": output.plan.motion.position[..., 1:, :]}
    # whoever rides to a goal that was not recorded cannot be judged
    goal = where_known(output.goal, stack.goal_known(batch).unsqueeze(-1))
    return Judged(scores, paths, goal, ego)


@torch.no_grad()
def judged_predictions(stack: DiffStackMMV, batch: StackBatch, first: int, seed: int = 0) -> Judged:
    """What a stack predicts for a batch, nothing planned; as `judged_plans`."""
    forecast = stack.predictor.predict(batch)
    ego = ego_forecast(forecast)
    further = _further_scores(ego, batch.ego_future, first, seed)
    scores = prediction_scores(batch, forecast) | further
    goal = where_known(batch.goal, batch.ego_future.valid[:, -1:])
    return Judged(scores, {"prediction": ego.median()}, goal, ego)


def _further_scores(forecast: Forecast, future: Tracks, first: int, seed: int) -> dict[str, Tensor]:
    """What a training does not log: scores of drawn paths."""
    return {
        **best_of_samples(forecast, future, seed, first),
        "energy_score": energy_score(forecast, future, seed=seed, first=first),
    }


@torch.no_grad()
def beside_baselines(
    judged: Judged, baselines: Mapping[str, Baseline], batch: StackBatch
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Scores of stack and baselines, and the distance to the human over time of each.

    Returns:
        Scores of shape (B,) by name, those of a baseline as "name/score"; distances of shape
        (B, T) in m.
    """
    future, scores, paths = batch.ego_future, dict(judged.scores), dict(judged.paths)
    for name, baseline in baselines.items():
        forecast = baseline.forecast(batch) if isinstance(baseline, PredictedPath) else None
        path = baseline(batch, judged.goal) if forecast is None else forecast.most_likely()
        paths[name], own = path, displacements(path, future)
        if forecast is not None:
            own["nll"] = negative_log_likelihood(forecast, future)
        scores |= {f"{name}/{score}": value for score, value in own.items()}
    return scores, {name: displacement_curve(path, future) for name, path in paths.items()}
