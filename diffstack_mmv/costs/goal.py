"""Terms that pull the plan to its goal."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.costs.base import CostTerm
from diffstack_mmv.geometry import direction, left_of
from diffstack_mmv.smooth import safe_norm
from diffstack_mmv.types import Motion, PlanningProblem


def _offset_to_goal(motion: Motion, problem: PlanningProblem) -> Float[Tensor, "*b t 2"]:
    return problem.goal.unsqueeze(-2) - motion.position


def _at_horizon(times: Float[Tensor, "*b t"]) -> Float[Tensor, " t"]:
    steps = torch.arange(times.shape[-1], device=times.device)
    return (steps == times.shape[-1] - 1).to(times.dtype)


class RunningGoal(CostTerm):
    """Squared distance to the goal ‖p_t - g‖² in m², at every time but the horizon."""

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in m² at each time, zero at the horizon."""
        distance = _offset_to_goal(motion, problem).square().sum(-1)
        return distance * (1 - _at_horizon(distance))


class FinalGoal(CostTerm):
    """Squared distance to the goal ‖p_T - g‖² in m², at the horizon only."""

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in m² at each time, zero before the horizon."""
        distance = _offset_to_goal(motion, problem).square().sum(-1)
        return distance * _at_horizon(distance)


class HeadingToGoal(CostTerm):
    """Misalignment 1 - cos(θ - θ_des), with θ_des the direction to the goal.

    Near the goal that direction is meaningless: the term fades as d² / (d² + d₀²). A fade as d
    itself would leave a cone at the goal, and a plan that ends on its tip has no derivatives there.

    Args:
        fade_m: d₀ in m.

    Raises:
        ValueError: The fading distance is not positive.
    """

    def __init__(self, fade_m: float = 1.0) -> None:
        super().__init__()
        require_positive("fade_m", fade_m)
        self.fade_m = fade_m

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value at each time, dimensionless, in [0, 2]."""
        offset = _offset_to_goal(motion, problem)
        ahead = offset[..., 0] * motion.heading.cos() + offset[..., 1] * motion.heading.sin()
        distance = safe_norm(offset)
        return distance * (distance - ahead) / (distance.square() + self.fade_m**2)


class ReferenceSpeed(CostTerm):
    """Squared deviation of the forward speed from the reference speed of the problem, in (m/s)²."""

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in (m/s)² at each time."""
        return (motion.velocity[..., 0] - problem.reference_speed.unsqueeze(-1)).square()


class BrakingProfile(CostTerm):
    """Squared deviation in (m/s)² from v_ref = min(v_max, sqrt(2 a d)), towards the goal.

    d is the distance to the goal, rounded to sqrt(d² + r²) - r over r = 3 cm; the root is smoothed
    to sqrt(2 a d + w²) - w and the minimum over a width w of 0.1 m/s. So v_ref is zero at the goal
    and has slopes everywhere: with a tip there, a plan that ends at the goal would not converge.
    It is about w below sqrt(2 a d) on the way; with a cruising speed of 3 m/s it is

    | a [m/s²] | at 0.3 m, where an episode has arrived | 3 cm before the goal |
    |---|---|---|
    | 1.5 | 0.81 m/s | 0.12 m/s |
    | 3.0 (`configs/cost`) | 1.18 m/s | 0.19 m/s |

    So at the edge of the goal it asks for no stop.
    Source: design of the closed-loop cost of DMMV, Sec. IV-B.

    Args:
        braking_mps2: a in m/s².

    Raises:
        ValueError: The deceleration is not positive.
    """

    def __init__(self, braking_mps2: float = 1.5) -> None:
        super().__init__()
        require_positive("braking_mps2", braking_mps2)
        self.braking_mps2 = braking_mps2

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in (m/s)² at each time."""
        width, rounding = 0.1, 0.03
        distance = safe_norm(_offset_to_goal(motion, problem), rounding**2) - rounding
        stopping = (2 * self.braking_mps2 * distance + width**2).sqrt() - width
        cruise = problem.reference_speed.unsqueeze(-1)
        reference = 0.5 * (stopping + cruise - ((stopping - cruise).square() + width**2).sqrt())
        return (motion.velocity[..., 0] - reference).square()


class GoalOutsideTurn(CostTerm):
    """Squared depth of the goal inside the smallest turning circles, Σ_i ReLU(ρ - ‖g - c_i‖)².

    A vehicle that only drives forward cannot turn into a point inside the circles that touch it on
    the left and right, c_L, c_R = p ± ρ n(θ); it would circle around such a goal for ever.

    Args:
        radius_min_m: ρ, the wheelbase over the tangent of the largest steering angle, in m.

    Raises:
        ValueError: The radius is not positive.
    """

    def __init__(self, radius_min_m: float = 1.0) -> None:
        super().__init__()
        require_positive("radius_min_m", radius_min_m)
        self.radius_min_m = radius_min_m

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in m² at each time."""
        offset = _offset_to_goal(motion, problem)
        left = left_of(direction(motion.heading))
        centre = self.radius_min_m * left
        distance = torch.stack([safe_norm(offset - centre, 1e-6), safe_norm(offset + centre, 1e-6)])
        return torch.relu(self.radius_min_m - distance).square().sum(0)
