"""What a stack made of a few samples, as plain numbers that a page can play."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from diffstack_mmv.prediction import strongest
from diffstack_mmv.stack.output import StackOutput
from diffstack_mmv.types import Forecast, Mode, Motion, StackBatch, Tracks, map_tensors

DIGITS = 3  # millimetres
OF_THE_EGO, OF_A_NEIGHBOR = 5, 2  # components that are kept
CANDIDATES = 30


def scene_records(
    batch: StackBatch, output: StackOutput, titles: Sequence[str]
) -> list[dict[str, Any]]:
    """One record per sample, for JSON: positions in m in the frame of the ego, None where unknown.

    A path is a list of (x, y, heading); a forecast has its `weight`, `mean` and `covariance` (xx,
    xy, yy in m²) per component, the most likely ones only.

    Args:
        batch: The samples.
        output: What the stack made of them.
        titles: Names of the samples.
    """
    here, made = map_tensors(lambda tensor: tensor.detach().cpu(), (batch, output))
    return [_record(here, made, row, title) for row, title in enumerate(titles)]


def _record(batch: StackBatch, output: StackOutput, row: int, title: str) -> dict[str, Any]:
    past, future, others, after, forecast, plan = map_tensors(
        lambda tensor: tensor[row],
        (
            batch.ego_past,
            batch.ego_future,
            batch.neighbors_past,
            batch.neighbors_future,
            output.forecast,
            output.plan,
        ),
    )
    seen = others.valid[..., -1].nonzero().squeeze(-1).tolist()
    candidates = plan.candidates.position
    each = max(-(-len(candidates) // CANDIDATES), 1)
    return {
        "title": title,
        "dt_s": batch.dt_s,
        "goal": _numbers(output.goal[row]),
        "ego": _agent(past, future),
        "plan": _path(plan.motion),
        "candidates": _numbers(candidates[::each]),
        "prediction": _forecast(forecast, 0, OF_THE_EGO),
        "neighbors": [
            _agent(*map_tensors(lambda tensor, agent=agent: tensor[agent], (others, after)))
            | {"prediction": _forecast(forecast, agent + 1, OF_A_NEIGHBOR)}
            for agent in seen
        ],
    }


def _agent(past: Tracks, future: Tracks) -> dict[str, Any]:
    """Mode, size and path of one agent."""
    return {
        "mode": Mode(int(past.mode)).label,
        "extent": _numbers(past.extent),
        "past": _path(past.motion, past.valid),
        "future": _path(future.motion, future.valid),
    }


def _path(motion: Motion, valid: Tensor | None = None) -> list[Any]:
    columns = np.concatenate([motion.position.numpy(), motion.heading[..., None].numpy()], -1)
    known = np.ones(len(columns), bool) if valid is None else valid.numpy()
    rows = np.round(columns.astype(np.float64), DIGITS).tolist()
    return [point if there else None for point, there in zip(rows, known, strict=True)]


def _forecast(forecast: Forecast, agent: int, count: int) -> dict[str, Any]:
    """The most likely components of one agent."""
    own = strongest(map_tensors(lambda tensor: tensor[agent], forecast), count)
    covariance = own.scale_tril @ own.scale_tril.mT
    told = covariance[..., [0, 0, 1], [0, 1, 1]]
    return {
        "weight": _numbers(own.log_weight.exp()),
        "mean": _numbers(own.mean),
        "covariance": _numbers(told),
    }


def _numbers(tensor: Tensor) -> Any:
    return np.round(tensor.double().numpy(), DIGITS).tolist()
