"""Where the people will be: forecasts that a controller plans against."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.simulation.pedestrians import CrowdState, OrcaCrowd
from diffstack_mmv.simulation.rounding import length, unit_vector
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


class Explained(NamedTuple):
    """Goals tried for each human, `*b h k`, and how well each explains what was observed."""

    goal: Float[Tensor, "*b h k 2"]  # m
    error: Float[Tensor, "*b h k"]  # m/s, of the velocity

    def best(self) -> Float[Tensor, "*b h 2"]:
        """The goal in m with the smallest error."""
        index = self.error.argmin(-1)[..., None, None]
        return self.goal.take_along_dim(index, -2).squeeze(-2)

    def fits(self, tolerance_mps: float) -> Bool[Tensor, "*b h 1"]:
        """Whether some goal explains the velocity within the tolerance."""
        return self.error.amin(-1, keepdim=True) < tolerance_mps


class _Memory(NamedTuple):
    """What is kept of the humans from one observation to the next, `*b h`."""

    crowd: CrowdState  # as it was observed, with the goals believed in
    dt_s: float


@dataclass
class OrcaPeople:
    """Everybody avoids everybody else by ORCA, towards a goal inferred from the walk so far.

    What is observed of a human's velocity is explained by a goal: ORCA is asked what the human
    would have done with each of many goals in the situation before. The goal believed in so far is
    kept as long as it explains the velocity; then comes the course of the velocity itself, then the
    best of a fan of far goals, and only where none of these explains it, the human is taken to be
    slowing down before its goal, which `towards` lays at p + v (1 s - dt). Who has not moved yet
    stays. The robot is no part of it.

    Attributes:
        crowd: Settings of ORCA.
        far_m: Distance of the guessed goal of somebody who is not arriving.
        preferred_speed_mps: Preferred speed of everybody.
        tolerance_mps: Largest error of the velocity under which a goal explains it.
        courses: Number of courses in the fan; the best of them is refined once by as many within
            its neighbors.

    Raises:
        ValueError: A number is not positive.
    """

    crowd: OrcaCrowd = field(default_factory=OrcaCrowd)
    far_m: float = 8.0
    preferred_speed_mps: float = 1.0
    tolerance_mps: float = 0.05
    courses: int = 16
    _memory: _Memory | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("far_m", self.far_m)
        require_positive("preferred_speed_mps", self.preferred_speed_mps)
        require_positive("tolerance_mps", self.tolerance_mps)
        require_at_least("courses", self.courses, 3)

    def __call__(
        self, observation: Observation, dt_s: float, steps: int
    ) -> Float[Tensor, "*b h T1 2"]:
        """Positions in m of the crowd rolled forward."""
        crowd = self._believed(observation)
        self._memory = _Memory(crowd, dt_s)
        positions = [crowd.position]
        for _ in range(steps):
            crowd = crowd.moved(self.crowd(crowd, dt_s), dt_s)
            positions.append(crowd.position)
        return torch.stack(positions, dim=-2)

    def _believed(self, observation: Observation) -> CrowdState:
        """The observed crowd with the goals believed in after this observation."""
        position, velocity = observation.human_position, observation.human_velocity
        preferred = torch.full_like(observation.human_radius, self.preferred_speed_mps)
        if self._memory is None or bool((observation.time == 0).any()):
            goal = self._at_first_sight(position, velocity)
        else:
            goal = self._inferred(self._memory, velocity)
        return CrowdState(position, velocity, goal, observation.human_radius, preferred)

    def _at_first_sight(
        self, position: Float[Tensor, "*b h 2"], velocity: Float[Tensor, "*b h 2"]
    ) -> Float[Tensor, "*b h 2"]:
        """Goal in m that the velocity alone suggests; somebody at rest is there already."""
        speed = length(velocity)[..., None]
        full = speed > 0.95 * self.preferred_speed_mps
        ahead = torch.where(full, self.far_m / speed.clamp(min=0.1), torch.full_like(speed, 1.0))
        return position + velocity * ahead

    def _inferred(
        self, memory: _Memory, velocity: Float[Tensor, "*b h 2"]
    ) -> Float[Tensor, "*b h 2"]:
        """Goals in m that explain the velocities after the situation in memory."""
        before = memory.crowd
        course = torch.atan2(velocity[..., 1], velocity[..., 0])[..., None]
        spacing = 2 * math.pi / self.courses
        turns = spacing * torch.arange(self.courses).to(course)
        fan = self._explained(before, self._far(before, course + turns), velocity, memory.dt_s)
        best = course + turns[fan.error.argmin(-1, keepdim=True)]
        finer = best + spacing * torch.linspace(-0.5, 0.5, self.courses).to(course)
        refined = self._explained(before, self._far(before, finer), velocity, memory.dt_s)
        kept = self._explained(before, before.goal.unsqueeze(-2), velocity, memory.dt_s)
        arriving = before.position + velocity
        goal = torch.where(refined.fits(self.tolerance_mps), refined.best(), arriving)
        ahead = Explained(fan.goal[..., :1, :], fan.error[..., :1])
        goal = torch.where(ahead.fits(self.tolerance_mps), ahead.best(), goal)
        return torch.where(kept.fits(self.tolerance_mps), kept.best(), goal)

    def _explained(
        self,
        before: CrowdState,
        goals: Float[Tensor, "*b h k 2"],
        velocity: Float[Tensor, "*b h 2"],
        dt_s: float,
    ) -> Explained:
        """Try goals in the situation before."""
        response = self.crowd.responses(before, goals, dt_s)
        return Explained(goals, length(response - velocity.unsqueeze(-2)))

    def _far(self, crowd: CrowdState, course: Float[Tensor, "*b h k"]) -> Float[Tensor, "*b h k 2"]:
        """Far goals on courses (rad)."""
        return crowd.position.unsqueeze(-2) + self.far_m * unit_vector(course)
