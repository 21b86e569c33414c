"""Forecasts that do not stake everything on one idea of what pedestrians do."""

import math
from collections.abc import Sequence
from typing import Any

import torch

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.simulation.forecasters import PedestrianForecast, PedestrianForecaster
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.types import Forecast


class MixedForecaster:
    """The components of several forecasters, each with its share of the probability.

    Args:
        forecasters: The forecasters.
        shares: Probability of each, which are normalised.

    Raises:
        ValueError: There are not as many shares as forecasters, or one is not positive.
    """

    def __init__(
        self, forecasters: Sequence[PedestrianForecaster], shares: Sequence[float]
    ) -> None:
        count = len(forecasters)
        require(len(shares) == count, "shares", f"be {count} numbers", list(shares))
        for share in shares:
            require_positive("shares", share)
        self.forecasters = list(forecasters)
        self.log_shares = [math.log(share / sum(shares)) for share in shares]

    def init(self, observation: Observation) -> tuple[Any, ...]:
        """What each of them begins with."""
        return tuple(each.init(observation) for each in self.forecasters)

    def __call__(
        self, state: tuple[Any, ...], observation: Observation, dt_s: float, steps: int
    ) -> PedestrianForecast:
        """All components."""
        told = [
            each(own, observation, dt_s, steps)
            for each, own in zip(self.forecasters, state, strict=True)
        ]
        weight = [
            each.forecast.log_weight + share
            for each, share in zip(told, self.log_shares, strict=True)
        ]
        forecast = Forecast(
            torch.cat(weight, -1),
            torch.cat([each.forecast.mean for each in told], -3),
            torch.cat([each.forecast.scale_tril for each in told], -4),
        )
        return PedestrianForecast(forecast, tuple(each.state for each in told))
