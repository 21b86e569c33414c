"""Distances between a path and the true positions, one number per sample.

NaN where a sample has no valid time to be judged at. What stands in rows that are not valid counts
neither in the value nor in the gradient.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.metrics.means import time_mean, where_known
from diffstack_mmv.types import Forecast, Tracks

MISS_M = 2.0
"""Distance at the horizon beyond which a prediction is a miss, as in Argoverse and nuScenes."""


def displacement_curve(path: Float[Tensor, "*b T 2"], future: Tracks) -> Float[Tensor, "*b T"]:
    """Distance in m to the true position at each time; NaN where that one is not valid."""
    return where_known(
        _offset(path, future.motion.position, future.valid).norm(dim=-1), future.valid
    )


def average_displacement(path: Float[Tensor, "*b T 2"], future: Tracks) -> Float[Tensor, "*b"]:
    """ADE in m: distance to the true position, mean over the valid times."""
    distance = _offset(path, future.motion.position, future.valid).norm(dim=-1)
    return time_mean(distance, future.valid)


def final_displacement(path: Float[Tensor, "*b T 2"], future: Tracks) -> Float[Tensor, "*b"]:
    """FDE in m: distance to the true position at the last time; NaN where that one is not valid."""
    return displacement_curve(path, future)[..., -1]


def displacements(path: Float[Tensor, "*b T 2"], future: Tracks) -> dict[str, Float[Tensor, "*b"]]:
    """ADE and FDE in m by their names."""
    return {"ade": average_displacement(path, future), "fde": final_displacement(path, future)}


def mean_square_displacement(path: Float[Tensor, "*b T 2"], future: Tracks) -> Float[Tensor, "*b"]:
    """Squared distance in m² to the true position, mean over the valid times."""
    offset = _offset(path, future.motion.position, future.valid)
    return time_mean(offset.square().sum(-1), future.valid)


def best_average_displacement(
    forecast: Forecast, future: Tracks, components: int = 5
) -> Float[Tensor, "*b"]:
    """Smallest ADE in m (minADE) among that many components, those with the largest weights."""
    count = min(components, forecast.log_weight.shape[-1])
    index = forecast.log_weight.topk(count, -1).indices[..., None, None]
    paths = forecast.mean.take_along_dim(index, -3)
    valid = future.valid.unsqueeze(-2)
    offset = _offset(paths, future.motion.position.unsqueeze(-3), valid)
    return time_mean(offset.norm(dim=-1), valid).amin(-1)


def missed(
    path: Float[Tensor, "*b T 2"], future: Tracks, limit_m: float = MISS_M
) -> Float[Tensor, "*b"]:
    """1 where the FDE is above a limit, else 0; NaN where there is no FDE."""
    distance = final_displacement(path, future)
    return where_known((distance > limit_m).to(distance), ~torch.isnan(distance))


def _offset(
    path: Float[Tensor, "*b T 2"],
    position: Float[Tensor, "*#b T 2"],
    valid: Bool[Tensor, "*#b T"],
) -> Float[Tensor, "*b T 2"]:
    """From the true position to the path in m, zero at times that are not valid."""
    offset = path - position
    return torch.where(valid.unsqueeze(-1), offset, torch.zeros_like(offset))
