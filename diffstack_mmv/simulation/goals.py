"""Where pedestrians want to go, as far as their walk so far tells."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between, require_positive
from diffstack_mmv.geometry import length, unit_vector, wrap_angle
from diffstack_mmv.simulation.pedestrians import CrowdState, OrcaCrowd

NOTICED_MPS = 0.3
"""Larger errors of the velocity are capped: the pedestrian may have changed course."""
SHARPNESS = 200.0
"""Courses beside the best one count by exp(-SHARPNESS · doubt)."""


class TriedGoals(NamedTuple):
    """Goals tried for each pedestrian, `*b h k`, and how well each explains what was observed."""

    goal: Float[Tensor, "*b h k 2"]  # m
    error: Float[Tensor, "*b h k"]  # m/s, of the velocity

    def first(self, count: int) -> list["TriedGoals"]:
        """The first goals, each by itself."""
        apart = self.goal[..., :count, :].split(1, -2), self.error[..., :count].split(1, -1)
        return [TriedGoals(*each) for each in zip(*apart, strict=True)]

    def best(self) -> Float[Tensor, "*b h 2"]:
        """The goal in m with the smallest error."""
        index = self.error.argmin(-1)[..., None, None]
        return self.goal.take_along_dim(index, -2).squeeze(-2)

    def fits(self, tolerance_mps: float) -> Bool[Tensor, "*b h 1"]:
        """Whether some goal explains the velocity within the tolerance."""
        return self.error.amin(-1, keepdim=True) < tolerance_mps


class InferredGoals(NamedTuple):
    """Goals believed in after an observation."""

    goal: Float[Tensor, "*b h 2"]  # m
    doubt: Float[Tensor, "*b h c"]  # (m/s)², what speaks against each course by now


@dataclass(frozen=True)
class GoalInference:
    """Goals that explain velocities by ORCA, with a memory.

    The goal believed in so far is kept as long as it explains the velocity; then comes the course
    of the velocity itself. In a crowd one velocity is explained by many goals or, where it avoids
    somebody who is out of sight, by none. Therefore the errors of a fan of courses are summed up
    over the walk, older ones discounted, and the goal is the course with the least sum, refined by
    what explains the present velocity. Where nothing does but a goal p + v (1 s - dt), at which
    `towards` slows down so, the pedestrian is arriving.

    Attributes:
        far_m: Distance of the guessed goal of somebody who is not arriving.
        tolerance_mps: Largest error of the velocity under which a goal explains it.
        courses: Number of courses of the fan.
        refinements: Number of courses tried between the best one and its neighbors.
        memory: Weight of an error one observation later.

    Raises:
        ValueError: A number is not positive, or the memory outside of [0, 1].
    """

    far_m: float = 8.0
    tolerance_mps: float = 0.05
    courses: int = 24
    refinements: int = 12
    memory: float = 0.85

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("far_m", self.far_m)
        require_positive("tolerance_mps", self.tolerance_mps)
        require_at_least("courses", self.courses, 3)
        require_at_least("refinements", self.refinements, 1)
        require_between("memory", self.memory, 0, 1)

    def __call__(
        self,
        model: OrcaCrowd,
        before: CrowdState,
        velocity: Float[Tensor, "*b h 2"],
        doubt: Float[Tensor, "*b h c"],
        dt_s: float,
    ) -> InferredGoals:
        """Goals that explain the velocities after the situation before.

        Args:
            model: How pedestrians walk to a goal.
            before: The crowd one observation ago, with the goals believed in then.
            velocity: Observed now, m/s.
            doubt: What spoke against each course so far, (m/s)².
            dt_s: Time between the observations.

        Returns:
            The goals, and the doubt with this observation.
        """

        def tried(goals: Float[Tensor, "*b h k 2"]) -> TriedGoals:
            response = model.responses(before, goals, dt_s)
            return TriedGoals(goals, length(response - velocity.unsqueeze(-2)))

        fan = 2 * math.pi / self.courses * torch.arange(self.courses).to(velocity)
        ahead = torch.atan2(velocity[..., 1], velocity[..., 0])[..., None]
        own = torch.stack([before.goal, before.position + velocity], -2)
        courses = torch.cat([ahead, fan.expand(*velocity.shape[:-1], -1)], -1)
        answers = tried(torch.cat([own, self._far(before, courses)], -2))
        kept, arriving, straight = answers.first(3)
        error = answers.error[..., 3:]
        doubt = self.memory * doubt + error.clamp(max=NOTICED_MPS).square()
        course = _least_doubted(fan, doubt)
        spread = 2 * math.pi / self.courses * torch.linspace(-1, 1, self.refinements).to(velocity)
        fine = tried(self._far(before, course + spread))
        goal = self._far(before, course).squeeze(-2)
        tolerance = self.tolerance_mps
        explained = fine.fits(tolerance) | (error.amin(-1, keepdim=True) < tolerance)
        goal = torch.where(~explained & arriving.fits(tolerance), arriving.best(), goal)
        for better in (fine, straight, kept):
            goal = torch.where(better.fits(tolerance), better.best(), goal)
        return InferredGoals(goal, doubt)

    def _far(self, crowd: CrowdState, course: Float[Tensor, "*b h k"]) -> Float[Tensor, "*b h k 2"]:
        """Far goals on courses (rad)."""
        return crowd.position.unsqueeze(-2) + self.far_m * unit_vector(course)


def _least_doubted(
    fan: Float[Tensor, " c"], doubt: Float[Tensor, "*b h c"]
) -> Float[Tensor, "*b h 1"]:
    """Course in rad of the least doubt, drawn towards those beside it that are hardly worse."""
    best = fan[doubt.argmin(-1, keepdim=True)]
    beside = wrap_angle(fan - best)
    weight = torch.softmax(-SHARPNESS * (doubt - doubt.amin(-1, keepdim=True)), -1)
    weight = weight * (beside.abs() < 3.1 * math.pi / len(fan))
    return best + (weight * beside).sum(-1, keepdim=True) / weight.sum(-1, keepdim=True)
