"""The interface of a cost term."""

from abc import ABC, abstractmethod
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.types import Motion, PlanningProblem


class CostTerm(nn.Module, ABC):
    """One summand of a plan's cost, not negative; entry t depends on motion and control at t alone.

    `controls` are relative to the limits of the vehicle (1 is the limit), so that terms know no
    vehicle; their last row, at the horizon, is zero. The leading dimensions of `problem` are those
    of the motion without time, or broadcast to them from the right, so that many candidates are
    scored against one problem.

    Attributes:
        adds_components: Whether the value is a sum over the components of all agents, each times
            its weight. Each component may then stand for an agent of its own.
    """

    adds_components: ClassVar[bool] = True

    @abstractmethod
    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value at each time, before the weight."""
