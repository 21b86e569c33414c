"""Where pedestrians want to go, as far as their walk so far tells."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least, require_between, require_positive
from diffstack_mmv.geometry import length, unit_vector
from diffstack_mmv.simulation.pedestrians import CrowdState, OrcaCrowd

ARRIVING, STRAIGHT = 0.02, 0.2
"""Probability of a new goal just ahead, and of one straight ahead; the rest lies all around."""
AHEAD = 0.6
"""Probability at first sight that a velocity tells the goal."""
NEAREST_M = 0.05
"""A goal nearer than this has no course."""


class GoalBelief(NamedTuple):
    """What is believed of the goals of pedestrians, `*b h k` each."""

    goal: Float[Tensor, "*b h k 2"]  # m, fixed in the world
    log_weight: Float[Tensor, "*b h k"]  # of their probabilities, in falling order

    def expected(self, position: Float[Tensor, "*b h 2"]) -> Float[Tensor, "*b h 2"]:
        """The goal in m that is likelier than all others together, or else one amid them.

        The latter lies at the mean distance in the mean direction, seen from the positions in m.
        """
        way = self.goal - position.unsqueeze(-2)
        distance = length(way)[..., None].clamp_min(NEAREST_M)
        weight = self.log_weight.exp()[..., None]
        course = (weight * way / distance).sum(-2)
        course = course / length(course)[..., None].clamp_min(1e-3)
        amid = position + (weight * distance).sum(-2) * course
        return torch.where(weight[..., 0, :] > 0.5, self.goal[..., 0, :], amid)


@dataclass(frozen=True)
class GoalInference:
    """Goals by Bayes' rule: ORCA is asked how a pedestrian would have walked to each of many goals.

    A velocity in a crowd is explained by many goals, of which later ones leave few, or, where
    somebody out of sight is avoided, by none. Goals may change, too:

        w(g) ∝ p(v | g) ((1 - c) w_before(g) + c p_new(g)),
        p(v | g) ∝ (1 - u) exp(-|v - v_ORCA(g)|² / (2 σ²)) + u

    with new goals all around, straight ahead, and at the place p + v (1 s) at which somebody slows
    down so who is arriving. The likeliest ones are kept.

    Attributes:
        far_m: Distance of new goals, but for who is arriving.
        courses: Number of new goals all around.
        kept: Number of goals that are kept for each pedestrian, at most one more than courses.
        deviation_mps: σ, error of the velocities that ORCA tells.
        unexplained: u, the weight of errors of any size.
        change: c, probability of a new goal from one observation to the next.

    Raises:
        ValueError: A number is not positive, or a probability not between 0 and 1.
    """

    far_m: float = 15.0
    courses: int = 72
    kept: int = 72
    deviation_mps: float = 0.03
    unexplained: float = 0.0005
    change: float = 0.05

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("far_m", self.far_m)
        require_at_least("courses", self.courses, 3)
        require_between("kept", self.kept, 1, self.courses + 1)
        require_positive("deviation_mps", self.deviation_mps)
        for name in ("unexplained", "change"):
            share = getattr(self, name)
            require(0 < share < 1, name, "lie between 0 and 1, without them", share)

    def first(
        self,
        position: Float[Tensor, "*b h 2"],
        velocity: Float[Tensor, "*b h 2"],
        preferred_mps: Float[Tensor, "*b h"],
    ) -> GoalBelief:
        """What one look tells: somebody at full speed goes straight on, others arrive, or neither.

        Args:
            position: In m.
            velocity: In m/s.
            preferred_mps: Preferred speeds.
        """
        speed = length(velocity)[..., None]
        full = speed > 0.95 * preferred_mps[..., None]
        ahead = torch.where(full, self.far_m / speed.clamp_min(0.1), torch.ones_like(speed))
        goal = torch.cat([(position + velocity * ahead).unsqueeze(-2), self._around(position)], -2)
        log_weight = torch.full_like(goal[..., 0], math.log((1 - AHEAD) / self.courses))
        log_weight[..., 0] = math.log(AHEAD)
        return self._likeliest(goal, log_weight)

    def __call__(
        self,
        model: OrcaCrowd,
        before: CrowdState,
        belief: GoalBelief,
        velocity: Float[Tensor, "*b h 2"],
        dt_s: float,
    ) -> GoalBelief:
        """What is believed after velocities have been observed.

        Args:
            model: How pedestrians walk to a goal.
            before: The crowd one observation ago; its own goals do not matter.
            belief: What was believed then.
            velocity: Observed now, m/s.
            dt_s: Time between the observations.
        """
        new = self._new(before.position, velocity)
        goal = torch.cat([belief.goal, new.goal], -2)
        known, fresh = math.log1p(-self.change), math.log(self.change)
        log_weight = torch.cat([belief.log_weight + known, new.log_weight + fresh], -1)
        error = length(model.responses(before, goal, dt_s) - velocity.unsqueeze(-2))
        fits = math.log1p(-self.unexplained) - 0.5 * (error / self.deviation_mps).square()
        anyhow = torch.full_like(fits, math.log(self.unexplained))
        return self._likeliest(goal, log_weight + torch.logaddexp(fits, anyhow))

    def _new(
        self, position: Float[Tensor, "*b h 2"], velocity: Float[Tensor, "*b h 2"]
    ) -> GoalBelief:
        """Goals that somebody may have taken here (m), seen from its velocity (m/s) since then."""
        course = torch.atan2(velocity[..., 1], velocity[..., 0])
        own = torch.stack([position + velocity, position + self.far_m * unit_vector(course)], -2)
        goal = torch.cat([own, self._around(position)], -2)
        around = (1 - ARRIVING - STRAIGHT) / self.courses
        weight = goal.new_tensor([ARRIVING, STRAIGHT] + self.courses * [around])
        return GoalBelief(goal, weight.log().expand(goal.shape[:-1]))

    def _around(self, position: Float[Tensor, "*b h 2"]) -> Float[Tensor, "*b h c 2"]:
        """Far goals on all courses, m."""
        fan = 2 * math.pi / self.courses * torch.arange(self.courses).to(position)
        return position.unsqueeze(-2) + self.far_m * unit_vector(fan)

    def _likeliest(
        self, goal: Float[Tensor, "*b h n 2"], log_weight: Float[Tensor, "*b h n"]
    ) -> GoalBelief:
        """As many of these goals (m) as are kept, with probabilities that add up to one."""
        log_weight, index = log_weight.topk(self.kept, -1)
        return GoalBelief(goal.take_along_dim(index[..., None], -2), log_weight.log_softmax(-1))
