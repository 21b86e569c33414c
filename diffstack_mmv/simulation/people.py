"""Where the people will be: forecasts that a controller plans against."""

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.simulation.pedestrians import CrowdState, OrcaCrowd
from diffstack_mmv.simulation.rounding import length
from diffstack_mmv.simulation.world import Observation


@runtime_checkable
class PeopleForecast(Protocol):
    """Predicts the humans of all episodes from what was observed so far."""

    def __call__(
        self, observation: Observation, dt_s: float, steps: int
    ) -> Float[Tensor, "*b h T1 2"]:
        """Positions in m now and after 1 .. `steps` steps of `dt_s`.

        Called once per control step, in the order of time; a time of zero starts new episodes.
        """
        ...


@dataclass(frozen=True)
class ConstantVelocityPeople:
    """Everybody walks on at the present velocity; it remembers nothing."""

    def __call__(
        self, observation: Observation, dt_s: float, steps: int
    ) -> Float[Tensor, "*b h T1 2"]:
        """Positions in m along straight lines."""
        position, velocity = observation.human_position, observation.human_velocity
        ahead = dt_s * torch.arange(steps + 1, dtype=position.dtype, device=position.device)
        return position.unsqueeze(-2) + velocity.unsqueeze(-2) * ahead[:, None]


class _Belief(NamedTuple):
    """What is believed of the humans after an observation, `*b h`."""

    crowd: CrowdState  # with the goals believed in
    predicted: Float[Tensor, "*b h 2"]  # m/s, the velocity expected for the next step


@dataclass
class OrcaPeople:
    """Everybody avoids everybody else by ORCA, towards a goal guessed from the walk so far.

    The guess is a hypothesis: as long as ORCA with the guessed goal reproduces the observed
    velocity, the goal is kept; once it fails, the goal is laid where the observed velocity points,
    `far_m` ahead, or, for somebody slower than the preferred speed, where the slowing down of
    `towards` ends, at p + v (1 s - dt). The robot is no part of it.

    Attributes:
        crowd: Settings of ORCA.
        far_m: Distance of the guessed goal of somebody at full speed.
        preferred_speed_mps: Preferred speed of everybody.
        tolerance_mps: Largest error of the velocity under which a hypothesis survives.

    Raises:
        ValueError: A number is not positive.
    """

    crowd: OrcaCrowd = field(default_factory=OrcaCrowd)
    far_m: float = 8.0
    preferred_speed_mps: float = 1.0
    tolerance_mps: float = 0.02
    _belief: _Belief | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("far_m", self.far_m)
        require_positive("preferred_speed_mps", self.preferred_speed_mps)
        require_positive("tolerance_mps", self.tolerance_mps)

    def __call__(
        self, observation: Observation, dt_s: float, steps: int
    ) -> Float[Tensor, "*b h T1 2"]:
        """Positions in m of the crowd rolled forward."""
        crowd = self._believed(observation)
        positions = [crowd.position]
        velocity = self.crowd(crowd, dt_s)
        self._belief = _Belief(crowd, velocity)
        for _ in range(steps):
            crowd = crowd.moved(velocity, dt_s)
            positions.append(crowd.position)
            velocity = self.crowd(crowd, dt_s)
        return torch.stack(positions, dim=-2)

    def _believed(self, observation: Observation) -> CrowdState:
        """The observed crowd with the goals believed in after this observation."""
        position, velocity = observation.human_position, observation.human_velocity
        goal = self._guessed(position, velocity)
        if self._belief is not None and not bool((observation.time == 0).any()):
            kept = self._survives(velocity)
            goal = torch.where(kept[..., None], self._belief.crowd.goal, goal)
        preferred = torch.full_like(observation.human_radius, self.preferred_speed_mps)
        return CrowdState(position, velocity, goal, observation.human_radius, preferred)

    def _survives(self, velocity: Float[Tensor, "*b h 2"]) -> Bool[Tensor, "*b h"]:
        """Which hypotheses explain the observed velocity."""
        if self._belief is None:
            return torch.zeros_like(velocity[..., 0], dtype=torch.bool)
        return length(velocity - self._belief.predicted) < self.tolerance_mps

    def _guessed(
        self, position: Float[Tensor, "*b h 2"], velocity: Float[Tensor, "*b h 2"]
    ) -> Float[Tensor, "*b h 2"]:
        """Goal in m that the velocity alone suggests; somebody at rest is there already."""
        speed = length(velocity)[..., None]
        full = speed > 0.95 * self.preferred_speed_mps
        ahead = torch.where(full, self.far_m / speed.clamp(min=0.1), torch.full_like(speed, 1.0))
        return position + velocity * ahead
