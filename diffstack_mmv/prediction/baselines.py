"""Predictors that learn nothing: what a learned one is compared with."""

from abc import abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import last_known, scale_from_covariance, times_ahead
from diffstack_mmv.prediction.base import Predictor, all_agents
from diffstack_mmv.prediction.current import (
    current_heading,
    current_position,
    mean_velocity,
    steady_path,
)
from diffstack_mmv.prediction.gaussian import covariance_along
from diffstack_mmv.smooth import safe_norm
from diffstack_mmv.types import Forecast, StackBatch, Tracks

SPREAD_ROWS = 5  # over which the speed that scales the uncertainty is measured
FAR_AWAY_M = 1e4  # out of reach of every cost, and well inside of float32


@dataclass(frozen=True)
class Spread:
    """Standard deviation of a prediction, growing with time and speed.

    sqrt(position² + (acceleration t² / 2)²) with acceleration = rest + gain · speed.

    Args:
        position_m: Error of the present position, along and across the course.
        rest_mps2: Unknown acceleration of an agent at rest, in any direction.
        along_per_s: Its growth with the speed, along the course.
        across_per_s: Its growth with the speed, across the course.

    Raises:
        ValueError: An entry is not positive.
    """

    position_m: float = 0.11
    rest_mps2: float = 0.1
    along_per_s: float = 0.3
    across_per_s: float = 0.15

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            require_positive(name, getattr(self, name))

    def scale_tril(
        self, course: Float[Tensor, "*b"], speed: Float[Tensor, "*b"], time: Float[Tensor, " T"]
    ) -> Float[Tensor, "*b T 2 2"]:
        """Cholesky factors in m at times in s for a course in rad and a speed in m/s."""

        def deviation(gain: float) -> Tensor:
            drift = 0.5 * (self.rest_mps2 + gain * speed.unsqueeze(-1)) * time.square()
            return (self.position_m**2 + drift.square()).sqrt()

        along, across = deviation(self.along_per_s), deviation(self.across_per_s)
        return scale_from_covariance(
            covariance_along(course.unsqueeze(-1).expand_as(along), along, across)
        )


def without_dynamics(predictor: Predictor, ego_dynamics: DynamicsModel) -> Predictor:
    """Return a predictor that has no use for the ego's dynamics, which each is offered."""
    return predictor


def single_component(
    mean: Float[Tensor, "*b T 2"], scale_tril: Float[Tensor, "*b T 2 2"]
) -> Forecast:
    """Forecast with one component of weight one."""
    return Forecast(
        mean.new_zeros(mean.shape[:-2]).unsqueeze(-1), mean.unsqueeze(-3), scale_tril.unsqueeze(-4)
    )


class Extrapolation(Predictor):
    """A predictor that treats every agent by itself and answers with one Gaussian per time.

    Args:
        horizon_steps: Number of predicted time steps T.
        dt_s: Length of one step in s.
        spread: How the uncertainty grows.
    """

    def __init__(
        self, horizon_steps: int = 30, dt_s: float = 0.1, spread: Spread | None = None
    ) -> None:
        super().__init__(horizon_steps, dt_s)
        self.spread = spread if spread is not None else Spread()

    def forward(self, past: Tracks, neighbors: Tracks) -> Forecast:
        """Forecast all agents, `*b 1+N`."""
        tracks = all_agents(past, neighbors)
        time = times_ahead(tracks.motion.position, self.horizon_steps, self.dt_s)
        heading = current_heading(tracks)
        speed = safe_norm(mean_velocity(tracks, SPREAD_ROWS, self.dt_s))
        return single_component(
            self.positions(tracks, time), self.spread.scale_tril(heading, speed, time)
        )

    @abstractmethod
    def positions(self, tracks: Tracks, time: Float[Tensor, " T"]) -> Float[Tensor, "*b T 2"]:
        """Positions in m of agents `*b` at times in s after their last row."""


class StandStill(Extrapolation):
    """Every agent stays where it is."""

    def positions(self, tracks: Tracks, time: Float[Tensor, " T"]) -> Float[Tensor, "*b T 2"]:
        """Positions in m of agents `*b` at times in s after their last row."""
        return current_position(tracks).unsqueeze(-2).expand(*tracks.mode.shape, len(time), 2)


class ConstantVelocity(Extrapolation):
    """Every agent keeps the velocity that it had on average over a short window.

    Args:
        horizon_steps: Number of predicted time steps T.
        dt_s: Length of one step in s.
        spread: How the uncertainty grows.
        window_s: Length of the window.

    Raises:
        ValueError: The window is not positive.
    """

    def __init__(
        self,
        horizon_steps: int = 30,
        dt_s: float = 0.1,
        spread: Spread | None = None,
        window_s: float = 0.5,
    ) -> None:
        super().__init__(horizon_steps, dt_s, spread)
        require_positive("window_s", window_s)
        self.rows = max(round(window_s / dt_s), 1)

    def positions(self, tracks: Tracks, time: Float[Tensor, " T"]) -> Float[Tensor, "*b T 2"]:
        """Positions in m of agents `*b` at times in s after their last row."""
        return steady_path(tracks, time, self.rows, self.dt_s)


class NoPrediction(ConstantVelocity):
    """The ego keeps its velocity; neighbors are far away, so that no plan reacts to them."""

    def forward(self, past: Tracks, neighbors: Tracks) -> Forecast:
        """Forecast all agents, `*b 1+N`, the neighbors out of reach."""
        forecast = super().forward(past, neighbors)
        ego = torch.arange(forecast.mean.shape[-4], device=forecast.mean.device) == 0
        mean = torch.where(
            ego[:, None, None, None], forecast.mean, torch.full_like(forecast.mean, FAR_AWAY_M)
        )
        return forecast._replace(mean=mean)

    def loss(self, batch: StackBatch) -> Float[Tensor, "*b"]:
        """Mean negative log density in nats of the ego's true positions."""
        nobody = batch.neighbors_past._replace(valid=torch.zeros_like(batch.neighbors_past.valid))
        return super().loss(batch._replace(neighbors_past=nobody))


class GroundTruth(Extrapolation):
    """Answers with the true future: the bound that no predictor can pass."""

    def predict(self, batch: StackBatch) -> Forecast:
        """Forecast `B 1+N` from the futures; who vanishes stays at the last true position."""
        past, future = (
            all_agents(batch.ego_past, batch.neighbors_past),
            all_agents(batch.ego_future, batch.neighbors_future),
        )
        mean = last_known(current_position(past), future.motion.position, future.valid)
        time = torch.zeros(mean.shape[-2], dtype=mean.dtype, device=mean.device)
        heading = current_heading(past)
        return single_component(
            mean, self.spread.scale_tril(heading, torch.zeros_like(heading), time)
        )

    def positions(self, tracks: Tracks, time: Float[Tensor, " T"]) -> Float[Tensor, "*b T 2"]:
        """Refuse: a past alone does not tell the future.

        Raises:
            TypeError: Always.
        """
        raise TypeError(
            "`GroundTruth` must see the future, but got a past alone. "
            "Call `predict` with a whole batch."
        )
