"""Local model of a constrained problem around trajectories, the problems in the first dimension."""

from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.constraint import ConstraintRows
from diffstack_mmv.control.expansion import (
    dynamics_curvature,
    expand_cost,
    linearise_dynamics,
    pad_controls,
)
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.selection import Selectable, constant
from diffstack_mmv.types import Bounds


class Problem(NamedTuple):
    """Everything that defines a batch of constrained problems."""

    dynamics: Any  # a Dynamics
    cost: Any  # a Cost
    rows: ConstraintRows
    bounds: Bounds
    state: Float[Tensor, "*b n"]

    @property
    def selectable(self) -> bool:
        """Whether some of the problems can be taken alone."""
        parts = (self.dynamics, self.cost, *self.rows.functions)
        return self.state.dim() == 2 and all(isinstance(part, Selectable) for part in parts)

    def select(self, index: Int[Tensor, " k"]) -> "Problem":
        """The problems `index` alone."""
        return Problem(
            self.dynamics.select(index),
            self.cost.select(index),
            self.rows.select(index),
            self.bounds,
            self.state[index],
        )

    def constant(self) -> "Problem":
        """The same without graph in the tensors that are named."""
        rows = self.rows
        functions = tuple(constant(function) for function in rows.functions)
        rows = rows._replace(
            functions=functions, linear=rows.linear.detach(), quadratic=rows.quadratic.detach()
        )
        bounds = Bounds(*(bound.detach().to(self.state) for bound in self.bounds))
        return Problem(
            constant(self.dynamics), constant(self.cost), rows, bounds, self.state.detach()
        )

    def rollout(self, controls: Float[Tensor, "*b T m"]) -> Float[Tensor, "*b T1 n"]:
        """States of given controls."""
        return rollout(self.dynamics, self.state, controls)

    def flat(self, part: Tensor) -> Tensor:
        """(*b, ...) to (N, ...), the problems in one dimension."""
        leading = self.state.shape[:-1]
        return part.reshape((leading.numel(), *part.shape[len(leading) :]))

    def unflat(self, part: Tensor) -> Tensor:
        """(N, ...) back to (*b, ...)."""
        return part.reshape((*self.state.shape[:-1], *part.shape[1:]))


def rollout(
    dynamics: Dynamics, state: Float[Tensor, "*b n"], controls: Float[Tensor, "*b T m"]
) -> Float[Tensor, "*b T1 n"]:
    """States of given controls."""
    states = [state]
    for control in controls.unbind(-2):
        states.append(dynamics(states[-1], control))
    return torch.stack(states, -2)


class Local(NamedTuple):
    """Linear dynamics and constraints, and the Hessian of the Lagrangian c + ν · g + λ · f."""

    A: Float[Tensor, "N T n n"]
    B: Float[Tensor, "N T n m"]
    xx: Float[Tensor, "N T1 n n"]
    ux: Float[Tensor, "N T m n"]
    uu: Float[Tensor, "N T m m"]
    costates: Float[Tensor, "N T n"]  # λ_1 .. λ_T
    gradient: Float[Tensor, "N T m"]  # of the Lagrangian by the controls
    values_x: Float[Tensor, "N T1 K n"]  # Jacobian of the constraints
    values_u: Float[Tensor, "N T K m"]
    magnitude: Float[Tensor, " N"]  # Σ|c|
    noise: Float[Tensor, " N"]  # what rounding does to the cost

    def select(self, index: Int[Tensor, " k"]) -> "Local":
        """Some of the problems."""
        return Local(*(part[index] for part in self))


def expand_problem(
    problem: Problem,
    x: Float[Tensor, "*b T1 n"],
    u: Float[Tensor, "*b T m"],
    multipliers: Float[Tensor, "*b T1 K"],
) -> Local:
    """Expand all problems around trajectories, with fixed multipliers of the constraints."""
    acting = pad_controls(u)
    A, B = linearise_dynamics(problem.dynamics, x[..., :-1, :], u)
    of_x, of_u, curvature = expand_cost(lagrangian(problem, multipliers), x, acting)
    costates = adjoint_states(A, of_x[..., 1:, :])
    bend = dynamics_curvature(problem.dynamics, x[..., :-1, :], u, costates)
    values_x, values_u = linearise_rows(problem.rows, x, acting)
    each = problem.cost(x, acting)
    magnitude = each.abs().sum(-1)
    change = magnitude + (x * of_x).abs().sum((-2, -1)) + (acting * of_u).abs().sum((-2, -1))
    parts = Local(
        A,
        B,
        torch.cat([curvature.xx[..., :-1, :, :] + bend.xx, curvature.xx[..., -1:, :, :]], -3),
        curvature.ux[..., :-1, :, :] + bend.ux,
        curvature.uu[..., :-1, :, :] + bend.uu,
        costates,
        of_u[..., :-1, :] + (B * costates.unsqueeze(-1)).sum(-2),
        values_x,
        values_u[..., :-1, :, :],
        magnitude,
        torch.finfo(x.dtype).eps * change,
    )
    return Local(*(problem.flat(part) for part in parts))


def lagrangian(problem: Problem, multipliers: Float[Tensor, "*b T1 K"]) -> Cost:
    """The cost with ν · g added."""

    def total(states: Tensor, controls: Tensor) -> Tensor:
        pressed = (multipliers * problem.rows.values(states, controls)).sum(-1)
        return problem.cost(states, controls) + pressed

    return total


def adjoint_states(
    A: Float[Tensor, "*b T n n"], of_x: Float[Tensor, "*b T n"]
) -> Float[Tensor, "*b T n"]:
    """λ_T = of_x,T and λ_t = of_x,t + A_t' λ_{t+1}, `of_x` beginning at t = 1."""
    value, found = of_x[..., -1, :], [of_x[..., -1, :]]
    for t in range(of_x.shape[-2] - 1, 0, -1):
        value = of_x[..., t - 1, :] + (A[..., t, :, :] * value.unsqueeze(-1)).sum(-2)
        found.append(value)
    return torch.stack(found[::-1], -2)


def linearise_rows(
    rows: ConstraintRows, x: Float[Tensor, "*b T1 n"], u: Float[Tensor, "*b T1 m"]
) -> tuple[Float[Tensor, "*b T1 K n"], Float[Tensor, "*b T1 K m"]]:
    """Jacobian of the constraints at each time, K cotangents pulled back in one call."""
    values, pull = torch.func.vjp(rows.values, x, u)[:2]
    seeds = torch.eye(values.shape[-1], dtype=x.dtype, device=x.device)
    of_x, of_u = torch.vmap(lambda seed: pull(seed.expand_as(values)))(seeds)
    return of_x.movedim(0, -2), of_u.movedim(0, -2)
