"""Modes of the gradient of a solution: implicit, or through the iterations."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.batch_last import from_batch_last
from diffstack_mmv.control.compilation import Kernels
from diffstack_mmv.control.curvature import CurvatureForm
from diffstack_mmv.control.implicit import StationaryPoint, attach
from diffstack_mmv.control.iteration import Iterate, Settings
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.riccati import is_active
from diffstack_mmv.control.selection import constant
from diffstack_mmv.types import Solution, SolverStatus


class Call(NamedTuple):
    """One call of the solver, its arguments checked."""

    kernels: Kernels
    dynamics: Dynamics
    cost: Cost
    settings: Settings
    state: Float[Tensor, "*b n"]
    controls: Float[Tensor, "*b T m"]
    curvature: CurvatureForm


Minimise = Callable[[Call], Iterate]


@runtime_checkable
class GradientMode(Protocol):
    """How a solution comes by its derivatives."""

    @property
    def through_iterations(self) -> bool:
        """Whether every kernel must be differentiable."""
        ...

    def __call__(self, minimise: Minimise, call: Call) -> Solution:
        """Solve, with the derivatives of this mode wherever a gradient is asked for."""
        ...


@dataclass(frozen=True)
class Implicit:
    """The exact derivative of the converged solution, whatever the iterations were (`implicit`)."""

    @property
    def through_iterations(self) -> bool:
        """No iteration is recorded."""
        return False

    def __call__(self, minimise: Minimise, call: Call) -> Solution:
        """Solve without a graph, and attach the derivatives at the end."""
        with torch.no_grad():
            settings = call.settings._replace(box=call.settings.box.detach())
            fixed = call._replace(
                dynamics=constant(call.dynamics), cost=constant(call.cost), settings=settings
            )
            solution, point = conclude(fixed, minimise(fixed))
        if not torch.is_grad_enabled():
            return solution
        solve = call.kernels.solve_free
        attached = attach(call.dynamics, call.cost, call.state, call.settings.box, point, solve)
        return solution if attached is None else solution._replace(**attached._asdict())


@dataclass(frozen=True)
class Unrolled:
    """The derivative of the iterations themselves: for comparison only.

    Memory and time of the backward pass grow with the number of iterations, and the gradient is as
    far from the exact one as the last iterate is from the solution: `Implicit` has neither fault.
    The residual is not computed (NaN).
    """

    @property
    def through_iterations(self) -> bool:
        """Every iteration is recorded."""
        return True

    def __call__(self, minimise: Minimise, call: Call) -> Solution:
        """Solve with the graph of every iteration."""
        iterate = minimise(call)
        like = call.state[..., 0]
        unknown = torch.full_like(iterate.cost, torch.nan).detach()
        parts = (iterate.x, iterate.u, iterate.cost, unknown, iterate.iterations, iterate.status)
        return Solution(*(from_batch_last(part, like) for part in parts))


def conclude(call: Call, iterate: Iterate) -> tuple[Solution, StationaryPoint]:
    """Residual and active bounds at the end; no problem gives NaN."""
    like = call.state.new_zeros(call.state.shape[:-1])
    x, u = iterate.x.nan_to_num(0.0), iterate.u.nan_to_num(0.0)
    # the gradient is all that is asked for here: the Hessian is completed for a derivative
    nowhere = torch.zeros_like(iterate.near)
    model = call.kernels.expand(call.dynamics, call.cost, like, x, u, nowhere)
    box = call.settings.box
    lower, upper = box.unsqueeze(-1)
    moved = torch.minimum(torch.maximum(u - model.gradient, lower), upper)
    residual = (u - moved).abs().amax((0, 1)).nan_to_num(torch.inf)
    free = ~is_active(u, model.gradient, box)
    converged = iterate.status == SolverStatus.CONVERGED
    exact = call.curvature.is_exact(x.shape[1])
    point = StationaryPoint(x, u, iterate.cost, free, converged, model, exact)
    parts = (x, u, iterate.cost, residual, iterate.iterations, iterate.status)
    return Solution(*(from_batch_last(part, like) for part in parts)), point
