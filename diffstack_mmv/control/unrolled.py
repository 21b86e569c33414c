"""Differentiation through the iterations themselves: for comparison only."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.batch_last import from_batch_last
from diffstack_mmv.control.ilqr import ILQR, check_problem
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.types import Bounds, Solution


@dataclass(frozen=True)
class UnrolledILQR:
    """Solves as `solver` does, eagerly, and keeps the graph of every iteration.

    Memory and time of the backward pass grow with the number of iterations, and the gradient is as
    far from the exact one as the last iterate is from the solution: `ILQR` has neither fault.

    Args:
        solver: Its settings; its limit of iterations is the number of steps that are unrolled.
    """

    solver: ILQR

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        bounds: Bounds,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
    ) -> Solution:
        """Solve with graph; the residual is not computed (NaN).

        Raises:
            ValueError: Shapes, precision or the order of the bounds do not fit.
            TypeError: The state is not of a floating-point type.
        """
        check_problem(bounds, state, controls)
        settings = self.solver.settings(bounds, state)
        kernels = self.solver.eager_kernels()
        iterate = self.solver.minimise(kernels, dynamics, cost, settings, state, controls)
        like = state[..., 0]
        unknown = torch.full_like(iterate.cost, torch.nan).detach()
        parts = (iterate.x, iterate.u, iterate.cost, unknown, iterate.iterations, iterate.status)
        return Solution(*(from_batch_last(part, like) for part in parts))
