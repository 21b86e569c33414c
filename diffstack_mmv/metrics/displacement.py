"""Distances between predicted and true positions.

The functions give one number per sample, NaN where a sample has no valid time to be judged at; the
classes are their means over all samples, summed over processes.
"""

from abc import abstractmethod
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torchmetrics import Metric

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.types import Forecast, Tracks


def time_mean(values: Float[Tensor, "*b T"], valid: Bool[Tensor, "*#b T"]) -> Float[Tensor, "*b"]:
    """Mean over the valid times, in the unit of the values; NaN where no time is valid."""
    return torch.where(valid, values, torch.zeros_like(values)).sum(-1) / valid.sum(-1)


def average_displacement(path: Float[Tensor, "*b T 2"], future: Tracks) -> Float[Tensor, "*b"]:
    """ADE in m: distance to the true position, mean over the valid times."""
    return time_mean((path - future.motion.position).norm(dim=-1), future.valid)


def final_displacement(path: Float[Tensor, "*b T 2"], future: Tracks) -> Float[Tensor, "*b"]:
    """FDE in m: distance to the true position at the last time; NaN where that one is not valid."""
    distance = (path[..., -1, :] - future.motion.position[..., -1, :]).norm(dim=-1)
    return torch.where(future.valid[..., -1], distance, torch.nan)


def best_average_displacement(
    forecast: Forecast, future: Tracks, components: int
) -> Float[Tensor, "*b"]:
    """Smallest ADE in m among that many components, those with the largest weights."""
    count = min(components, forecast.log_weight.shape[-1])
    index = forecast.log_weight.topk(count, -1).indices[..., None, None]
    error = forecast.mean.take_along_dim(index, -3) - future.motion.position.unsqueeze(-3)
    return time_mean(error.norm(dim=-1), future.valid.unsqueeze(-2)).amin(-1)


class ForecastMetric(Metric):
    """Mean over samples of a number that a forecast and the truth give, NaN left out.

    `update` takes a forecast `*b K T` of single agents and their true tracks `*b T`; `compute` is
    NaN before any sample.
    """

    full_state_update = False
    is_differentiable = False
    unit: ClassVar[str] = "m"
    title: ClassVar[str]

    def __init__(self) -> None:
        super().__init__()
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.total: Tensor
        self.count: Tensor

    def update(self, forecast: Forecast, future: Tracks) -> None:
        """Add the samples of a batch."""
        scores = self.scores(forecast, future).detach()
        judged = ~torch.isnan(scores)
        self.total += scores[judged].sum(dtype=torch.float64)
        self.count += judged.sum()

    def compute(self) -> Float[Tensor, ""]:
        """Mean over all samples, in `unit`."""
        return (self.total / self.count).float()

    @abstractmethod
    def scores(self, forecast: Forecast, future: Tracks) -> Float[Tensor, "*b"]:
        """One number per sample, in `unit`."""


class AverageDisplacement(ForecastMetric):
    """ADE of the most likely trajectory."""

    higher_is_better = False
    title = "ADE"

    def scores(self, forecast: Forecast, future: Tracks) -> Float[Tensor, "*b"]:
        """ADE of each sample in m."""
        return average_displacement(forecast.most_likely(), future)


class FinalDisplacement(ForecastMetric):
    """FDE of the most likely trajectory."""

    higher_is_better = False
    title = "FDE"

    def scores(self, forecast: Forecast, future: Tracks) -> Float[Tensor, "*b"]:
        """FDE of each sample in m."""
        return final_displacement(forecast.most_likely(), future)


class MinimumDisplacement(ForecastMetric):
    """minADE_k: the ADE of the best of the k most likely trajectories.

    Args:
        components: k.

    Raises:
        ValueError: k is below one.
    """

    higher_is_better = False
    title = "minADE"

    def __init__(self, components: int = 5) -> None:
        super().__init__()
        require_at_least("components", components, 1)
        self.components = components

    def scores(self, forecast: Forecast, future: Tracks) -> Float[Tensor, "*b"]:
        """minADE_k of each sample in m."""
        return best_average_displacement(forecast, future, self.components)


class MissRate(ForecastMetric):
    """Share of samples whose most likely trajectory ends further away from the truth than a limit.

    Args:
        limit_m: The limit.

    Raises:
        ValueError: The limit is not positive.
    """

    higher_is_better = False
    unit = "1"
    title = "miss rate"

    def __init__(self, limit_m: float = 2.0) -> None:
        super().__init__()
        require_positive("limit_m", limit_m)
        self.limit_m = limit_m

    def scores(self, forecast: Forecast, future: Tracks) -> Float[Tensor, "*b"]:
        """1 for a miss, 0 for a hit."""
        distance = final_displacement(forecast.most_likely(), future)
        return torch.where(torch.isnan(distance), distance, (distance > self.limit_m).to(distance))
