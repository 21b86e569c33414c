"""Terms that keep the plan near a reference trajectory."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.costs.base import CostTerm
from diffstack_mmv.types import Motion, PlanningProblem


class ReferenceTracking(CostTerm):
    """Squared distance ‖p_t - p_ref,t‖² in m² to the reference trajectory of the problem."""

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in m² at each time."""
        return (motion.position - problem.reference).square().sum(-1)
