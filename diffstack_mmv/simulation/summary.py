"""The numbers of a closed-loop benchmark, as a file tells them."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from diffstack_mmv.simulation.chunks import Chunk
from diffstack_mmv.types import Outcome


def episode_scores() -> dict[str, Callable[[], Any]]:
    """Metric of each score, by the names and in the order of `CLOSED_LOOP`."""
    from diffstack_mmv.metrics import navigation

    return {
        "success_rate": navigation.SuccessRate,
        "collision_rate": navigation.CollisionRate,
        "incomplete_rate": navigation.IncompleteRate,
        "nav_time_s": navigation.NavigationTime,
        "nav_time_all_s": navigation.NavigationTimeOfAll,
        "discomfort_frequency": navigation.DiscomfortFrequency,
        "avg_min_dist_m": navigation.DiscomfortDistance,
        "mean_episode_min_dist_m": navigation.EpisodeMinimumDistance,
        "acceleration_mps2": navigation.RideAcceleration,
        "jerk_mps3": navigation.RideJerk,
    }


def summarise(chunks: Sequence[Chunk]) -> dict[str, Any]:
    """Scores, intervals of 95 %, times of decisions, convergence and the cases one by one.

    Args:
        chunks: All chunks of one method.

    Returns:
        A dictionary for JSON; a score without any case that counts is None.
    """
    from diffstack_mmv.metrics.navigation import OutcomeRate

    metrics = {name: score() for name, score in episode_scores().items()}
    for chunk in chunks:
        for metric in metrics.values():
            metric.update(chunk.record)
    scores = {name: _number(metric.compute()) for name, metric in metrics.items()}
    intervals = {
        f"{name}_ci95": [_number(end) for end in metric.interval()]
        for name, metric in metrics.items()
        if isinstance(metric, OutcomeRate)
    }
    seconds = np.concatenate([chunk.step_s for chunk in chunks])
    cases = [case for chunk in chunks for case in _cases(chunk)]
    return {
        "n": len(cases),
        **scores,
        **intervals,
        "control_time_ms": {
            "median": 1e3 * float(np.median(seconds)),
            "p99": 1e3 * float(np.quantile(seconds, 0.99)),
            "per": "decision and episode, in a batch",
        },
        "real_time_factor": _real_time_factor(chunks),
        "solved_share": _solved_share(cases),
        "cases": cases,
    }


def _real_time_factor(chunks: Sequence[Chunk]) -> float:
    """Time driven over time spent in deciding, over all episodes: above one keeps up."""
    driven = decided = 0.0
    for chunk in chunks:
        steps = chunk.record.steps.numpy()
        running = (steps[:, None] > np.arange(len(chunk.step_s))).sum(0)
        driven += chunk.record.dt_s * float(steps.sum())
        decided += float((np.maximum(running, 1) * chunk.step_s).sum())
    return driven / max(decided, 1e-9)


def _solved_share(cases: Sequence[dict[str, Any]]) -> float | None:
    """Share of the solves that converged, where the controller solves anything."""
    weighed = [(case["solved_share"], case["steps"]) for case in cases if "solved_share" in case]
    total = sum(steps for _, steps in weighed)
    return sum(share * steps for share, steps in weighed) / total if total else None


def _number(value: torch.Tensor) -> float | None:
    """A number for JSON, which knows no NaN."""
    number = float(value)
    return number if math.isfinite(number) else None


def _cases(chunk: Chunk) -> list[dict[str, Any]]:
    """One entry per case."""
    from diffstack_mmv.metrics.navigation import ride, uneasy_steps

    record = chunk.record
    nearest = record.clearance.amin(dim=1)
    uneasy, comfort = uneasy_steps(record).sum(dim=1), ride(record)
    return [
        {
            "case": number,
            "outcome": Outcome(int(record.outcome[row])).label,
            "time_s": float(record.duration[row]),
            "steps": int(record.steps[row]),
            "min_clearance_m": _number(nearest[row]),
            "discomfort_steps": int(uneasy[row]),
            "acceleration_mps2": _number(comfort.acceleration[row]),
            "jerk_mps3": _number(comfort.jerk[row]),
        }
        | {name: _number(torch.tensor(value[row])) for name, value in chunk.diagnosis.items()}
        for row, number in enumerate(chunk.cases)
    ]
