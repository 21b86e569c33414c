"""Where the pedestrians will be: forecasts that a controller plans against."""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between, require_positive, require_switch
from diffstack_mmv.geometry import length, times_ahead, unit_vector
from diffstack_mmv.prediction import Spread, single_component
from diffstack_mmv.simulation.goals import GoalBelief, GoalInference
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.simulation.pedestrians import CrowdState, OrcaCrowd
from diffstack_mmv.types import Forecast

RESTING_MPS = 0.05
"""Below this speed a pedestrian counts as standing."""


class PedestrianForecast(NamedTuple):
    """A forecast, and what its source has to remember for the next one."""

    forecast: Forecast  # *b h K T
    state: Any


@runtime_checkable
class PedestrianForecaster(Protocol):
    """Predicts the pedestrians of all episodes from what was observed so far.

    Its state is a record of its own, which only the forecaster itself reads.
    """

    def init(self, observation: Observation) -> Any:
        """State at the start of episodes, before anything is forecast."""
        ...

    def __call__(
        self, state: Any, observation: Observation, dt_s: float, steps: int
    ) -> PedestrianForecast:
        """Forecast after 1 .. `steps` steps of `dt_s`, in the order of time.

        Args:
            state: What `init` or the call before gave.
            observation: All episodes, `*b`.
            dt_s: Step of the forecast.
            steps: Number of steps T.

        Returns:
            Weighted components of the positions of all pedestrians, `*b h K T`, and the state.
        """
        ...


@dataclass(frozen=True)
class ConstantVelocityForecaster:
    """Everybody walks on at the present velocity; it remembers nothing.

    Attributes:
        spread: How the uncertainty grows.
    """

    spread: Spread = field(default_factory=Spread)

    def init(self, observation: Observation) -> None:
        """Nothing to remember."""
        return

    def velocity(self, observation: Observation) -> Float[Tensor, "*b h 2"]:
        """Velocity in m/s that everybody is taken to keep."""
        return observation.pedestrian_velocity

    def __call__(
        self, state: None, observation: Observation, dt_s: float, steps: int
    ) -> PedestrianForecast:
        """One component along straight lines."""
        position, velocity = observation.pedestrian_position, self.velocity(observation)
        ahead = times_ahead(position, steps, dt_s).unsqueeze(-1)
        mean = position.unsqueeze(-2) + velocity.unsqueeze(-2) * ahead
        return PedestrianForecast(_with_spread(mean, velocity, self.spread, dt_s), None)


@dataclass(frozen=True)
class StandingForecaster(ConstantVelocityForecaster):
    """Everybody stops at once and stays."""

    def velocity(self, observation: Observation) -> Float[Tensor, "*b h 2"]:
        """None, in m/s."""
        return torch.zeros_like(observation.pedestrian_velocity)


@dataclass(frozen=True)
class TurningForecaster(ConstantVelocityForecaster):
    """Everybody turns off by an angle at once and walks on, at no less than a speed.

    Attributes:
        spread: How the uncertainty grows.
        turn_deg: To the left; negative: to the right.
        speed_mps: Who stands walks off so fast, facing along its last step or, at rest, along x.
    """

    turn_deg: float = 90.0
    speed_mps: float = 0.0

    def velocity(self, observation: Observation) -> Float[Tensor, "*b h 2"]:
        """The present velocity, turned, in m/s."""
        speed = length(observation.pedestrian_velocity)
        course = _course(observation.pedestrian_velocity)
        turned = unit_vector(course + math.radians(self.turn_deg))
        return speed.clamp_min(self.speed_mps)[..., None] * turned


class BelievedCrowd(NamedTuple):
    """What is kept of the pedestrians from one observation to the next, `*b h`."""

    crowd: CrowdState  # as it was observed, with the goals and speeds believed in
    seen: Bool[Tensor, "*b h"]
    time: Float[Tensor, "*b"]  # s
    goals: GoalBelief


@dataclass(frozen=True)
class OrcaForecaster:
    """Everybody avoids everybody else by ORCA, towards a goal inferred from the walk so far.

    Goals are inferred by `GoalInference`: ORCA is asked what a pedestrian would have done with each
    of many goals in the situation before. The robot is no part of it. ORCA parts overlapping discs
    within one step: in the question that is the time between the observations, in the forecast the
    step of the forecast.

    At first sight nobody's goal is known. Who is at rest then may walk off in any direction: beside
    the component in which it stays there is one for each of `directions`, straight at the preferred
    speed. A single one of them is unlikely; a plan pays for all.

    Attributes:
        crowd: Settings of ORCA.
        preferred_speed_mps: Preferred speed of everybody, or of who has not walked yet.
        observed_speed: Whether the preferred speed of who has walked is the largest that was seen.
        inference: How goals are inferred.
        directions: Number of directions in which somebody at rest at first sight may walk off.
        stays: Probability that it stays.
        spread: How the uncertainty grows.

    Raises:
        ValueError: A number is not positive, or the probability outside of [0, 1].
    """

    crowd: OrcaCrowd = field(default_factory=OrcaCrowd)
    preferred_speed_mps: float = 1.0
    inference: GoalInference = field(default_factory=GoalInference)
    directions: int = 24
    stays: float = 0.1
    observed_speed: bool = False
    spread: Spread = field(default_factory=Spread)

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_at_least("directions", self.directions, 1)
        require_between("stays", self.stays, 0, 1)
        require_positive("preferred_speed_mps", self.preferred_speed_mps)
        require_switch("observed_speed", self.observed_speed)

    def init(self, observation: Observation) -> None:
        """Nothing has been seen yet."""
        return

    def __call__(
        self, state: BelievedCrowd | None, observation: Observation, dt_s: float, steps: int
    ) -> PedestrianForecast:
        """One component, the crowd rolled forward; at first sight also walking off."""
        believed, goals = self._believed(state, observation, dt_s)
        mean = self.crowd.positions(believed, dt_s, steps)
        forecast = _with_spread(mean, believed.velocity, self.spread, dt_s)
        if state is None:
            forecast = self._walking_off(forecast, believed, dt_s)
        known = BelievedCrowd(believed, observation.seen, observation.time, goals)
        return PedestrianForecast(forecast, known)

    def _walking_off(self, forecast: Forecast, crowd: CrowdState, dt_s: float) -> Forecast:
        """A forecast of one component, and one more per direction for who is at rest."""
        mean, count = forecast.mean, self.directions
        turns = 2 * math.pi / count * torch.arange(count).to(mean)
        ahead = times_ahead(mean, mean.shape[-2], dt_s).unsqueeze(-1)
        way = self.preferred_speed_mps * ahead * unit_vector(turns)[:, None]
        resting = (length(crowd.velocity) < RESTING_MPS)[..., None, None, None]
        off = torch.where(resting, crowd.position[..., None, None, :] + way, mean)
        weight = mean.new_tensor([self.stays] + count * [(1 - self.stays) / count])
        scale = forecast.scale_tril
        return Forecast(
            weight.log().expand(*forecast.log_weight.shape[:-1], 1 + count),
            torch.cat([mean, off], -3),
            scale.expand(*scale.shape[:-4], 1 + count, *scale.shape[-3:]),
        )

    def _believed(
        self, state: BelievedCrowd | None, observation: Observation, dt_s: float
    ) -> tuple[CrowdState, GoalBelief]:
        """The observed crowd with the goals that are expected now, and what is believed of them."""
        position, velocity = observation.pedestrian_position, observation.pedestrian_velocity
        preferred = self._preferred(state, observation)
        goals = self.inference.first(position, velocity, preferred)
        if state is not None:
            # of the episodes that go on; where none has, the step of the forecast is as good as any
            passed_s = float((observation.time - state.time).max())
            passed_s = passed_s if passed_s > 0 else dt_s
            goals = _where(
                observation.seen & state.seen,
                self.inference(self.crowd, state.crowd, state.goals, velocity, passed_s),
                goals,
            )
        expected = goals.expected(position)
        crowd = CrowdState(position, velocity, expected, observation.pedestrian_radius, preferred)
        return crowd, goals

    def _preferred(
        self, state: BelievedCrowd | None, observation: Observation
    ) -> Float[Tensor, "*b h"]:
        """Preferred speeds in m/s that are believed in."""
        usual = torch.full_like(observation.pedestrian_radius, self.preferred_speed_mps)
        if not self.observed_speed:
            return usual
        speed = length(observation.pedestrian_velocity)
        walked = speed > RESTING_MPS
        if state is None:
            return torch.where(walked, speed, usual)
        before = state.crowd.preferred_speed
        first = ~state.seen | (length(state.crowd.velocity) < RESTING_MPS) & (before == usual)
        return torch.where(walked, torch.where(first, speed, torch.maximum(speed, before)), before)


def _course(velocity: Float[Tensor, "*b h 2"]) -> Float[Tensor, "*b h"]:
    return torch.atan2(velocity[..., 1], velocity[..., 0])


def _where(known: Bool[Tensor, "*b h"], then: GoalBelief, other: GoalBelief) -> GoalBelief:
    """The first belief of who is known, the other of the rest."""
    goal = torch.where(known[..., None, None], then.goal, other.goal)
    return GoalBelief(goal, torch.where(known[..., None], then.log_weight, other.log_weight))


def _with_spread(
    mean: Float[Tensor, "*b h T 2"], velocity: Float[Tensor, "*b h 2"], spread: Spread, dt_s: float
) -> Forecast:
    """One component of positions in m whose uncertainty grows along and across the course."""
    time = times_ahead(mean, mean.shape[-2], dt_s)
    return single_component(mean, spread.scale_tril(_course(velocity), length(velocity), time))
