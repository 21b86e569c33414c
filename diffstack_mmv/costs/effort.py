"""Terms that price the use of controls and the discomfort of turning."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.costs.base import CostTerm
from diffstack_mmv.types import Motion, PlanningProblem


class ControlEffort(CostTerm):
    """Sum of the squared controls, each relative to its bound, dimensionless.

    Bounds are those of the dynamics. The steering of DiffGM3 is a command that a soft clamp takes
    to an angle, bounded at twice the steering limit: a command as large as the limit costs 1/4,
    where the steering angle of DiffKBM at its limit costs 1.
    """

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value at each time; 1 per control at its bound."""
        return controls.square().sum(-1)


class YawRate(CostTerm):
    """Squared yaw rate r² in (rad/s)²."""

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in (rad/s)² at each time."""
        return motion.yaw_rate.square()


class LateralAcceleration(CostTerm):
    """Squared lateral acceleration (v r)² in (m/s²)²."""

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in (m/s²)² at each time."""
        return (motion.velocity[..., 0] * motion.yaw_rate).square()
