"""Terms that keep the motion within the limits of the vehicle."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.costs.base import CostTerm
from diffstack_mmv.types import Motion, PlanningProblem


class SpeedLimit(CostTerm):
    """Squared excess ReLU(|v| - v_ref)² of the speed ahead or backwards over v_ref, in (m/s)².

    v_ref is the reference speed.
    """

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in (m/s)² at each time."""
        excess = motion.velocity[..., 0].abs() - problem.reference_speed.unsqueeze(-1)
        return torch.relu(excess).square()


class Reversing(CostTerm):
    """Squared speed backwards ReLU(-v)² in (m/s)²: nobody rides a two-wheeler in reverse.

    Zero for models that cannot go backwards; the unicycle can.
    """

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in (m/s)² at each time."""
        return torch.relu(-motion.velocity[..., 0]).square()
