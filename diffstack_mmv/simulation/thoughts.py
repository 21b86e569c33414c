"""What a planning controller expected and intended at each decision, kept to be looked at."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.types import Forecast, Plan


class Thought(NamedTuple):
    """Forecast and plan of one decision, for the episodes that still ran."""

    rows: Int[Tensor, " r"]  # number of the episode
    plan: Float[Tensor, "r T1 2"]  # m
    forecast: Float[Tensor, "r h T 5"]  # m, m²: x, y, and the covariance xx, xy, yy
    candidates: Float[Tensor, "r c T1 2"]  # m, some of the proposals


CANDIDATES = 24
"""At most about so many of the proposals are kept."""


@torch.no_grad()
def thought(plan: Plan, forecast: Forecast, rows: Int[Tensor, " r"]) -> Thought:
    """The planned path, the likeliest component of each pedestrian, some proposals, in float32.

    Args:
        plan: Of the running episodes.
        forecast: Of all episodes.
        rows: Numbers of the running ones.
    """
    best = Forecast(*(field[rows].float() for field in forecast)).likeliest()
    mean, scale = best.mean.squeeze(-3), best.scale_tril.squeeze(-4)
    spread = (scale @ scale.mT)[..., [0, 0, 1], [0, 1, 1]]
    proposed = plan.candidates.position.detach().float()
    some = proposed[:, :: max(1, -(-proposed.shape[1] // CANDIDATES))]
    return Thought(rows, plan.motion.position.float(), torch.cat([mean, spread], -1), some)


def joined(thoughts: Sequence[Thought], episodes: int) -> dict[str, Float[np.ndarray, "E S *d"]]:
    """Plans and forecasts by episode and decision; NaN after the end of an episode.

    Args:
        thoughts: One per decision.
        episodes: How many there are.

    Returns:
        Half precision is enough for a picture: millimetres near the origin.
    """
    arrays = {}
    for name in ("plan", "forecast", "candidates"):
        told = [getattr(each, name).cpu().numpy() for each in thoughts]
        most = max(each.shape[1] for each in told)
        shape = (episodes, len(thoughts), most, *told[0].shape[2:])
        arrays[name] = np.full(shape, np.nan, np.float16)
        for step, each in enumerate(thoughts):
            arrays[name][each.rows.cpu().numpy(), step, : told[step].shape[1]] = told[step]
    return arrays
