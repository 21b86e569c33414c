"""Derivatives of a solution by the implicit function theorem, exact.

At a solution z* = (x_1 .. x_T, u_0 .. u_{T-1}) with costates λ the residual

    R(z, λ; θ) = (∂L/∂x_t, ∂L/∂u_t on the controls inside of the box, f(x_t, u_t) - x_{t+1})
    L(z, λ; θ) = Σ c_t(x_t, u_t) + Σ λ_{t+1} · (f(x_t, u_t) - x_{t+1})

vanishes, so dz* = -K⁻¹ ∂R/∂θ dθ with the KKT matrix K = ∂R/∂(z, λ), which holds the Hessian of the
Lagrangian: that of the cost and the curvature λ · ∂²f of the dynamics. The callables hide θ
(closures, modules), therefore R is evaluated once WITH graph at the constant solution, and a custom
function puts K⁻¹ between R and z*: its backward pass is one linear-quadratic problem, and autograd
goes on from R into whatever θ is.

Source: Amos et al., Differentiable MPC for End-to-end Planning and Control, NeurIPS 2018, with the
full Hessian.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.batch_last import from_batch_last, to_batch_last, unpack
from diffstack_mmv.control.expansion import Model, expand, pad_controls, step_all
from diffstack_mmv.control.once import once
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.riccati import LinearQuadratic, Stationary, solve_free, stage_shapes
from diffstack_mmv.control.selection import lenders, lent

Solve = Callable[[LinearQuadratic, Tensor, int], Stationary]


class StationaryPoint(NamedTuple):
    """Converged trajectories, constants of the differentiation."""

    x: Float[Tensor, "T1 n N"]
    u: Float[Tensor, "T m N"]
    cost: Float[Tensor, " N"]
    free: Bool[Tensor, "T m N"]  # controls that are not active
    valid: Bool[Tensor, " N"]  # problems that carry a gradient
    model: Model
    exact: bool  # whether the model has the exact Hessian already


class Attached(NamedTuple):
    """The values of a stationary point with their derivatives."""

    states: Float[Tensor, "*b T1 n"]
    controls: Float[Tensor, "*b T m"]
    cost: Float[Tensor, "*b"]


class _Implicit(torch.autograd.Function):
    """z* and its cost as functions of KKT residual, Lagrangian and held controls.

    dz* = -K⁻¹ dR with the active controls on their bounds; the derivative of the cost is that of
    the Lagrangian.
    """

    @staticmethod
    def forward(
        ctx: Any,
        of_x: Tensor,
        of_u: Tensor,
        following: Tensor,
        lagrangian: Tensor,
        held: Tensor,
        point: StationaryPoint,
        solve: Solve,
    ) -> tuple[Tensor, Tensor, Tensor]:
        ctx.point, ctx.solve = point, solve
        ctx.save_for_backward(of_x, of_u, following, lagrangian)
        return point.x[1:].clone(), point.u.clone(), point.cost.clone()

    @staticmethod
    def backward(
        ctx: Any, grad_x: Tensor, grad_u: Tensor, grad_cost: Tensor
    ) -> tuple[Tensor | None, ...]:
        point: StationaryPoint = ctx.point
        with torch.no_grad():
            dual = ctx.solve(
                _adjoint(point, grad_x, grad_u), point.free.to(grad_u.dtype), len(point.x[0])
            )
            pulled = _pulled(point, dual, grad_u, grad_cost) if ctx.needs_input_grad[4] else None
            parts = *(-part for part in dual), grad_cost, pulled
            # where, not a product: the adjoint of a problem that did not converge may be anything
            masked = [None if p is None else torch.where(point.valid, p, 0.0) for p in parts]
        return *once(masked, *ctx.saved_tensors), None, None


def _adjoint(point: StationaryPoint, grad_x: Tensor, grad_u: Tensor) -> LinearQuadratic:
    """The quadratic model at a point with other linear terms."""
    n, m = grad_x.shape[1], grad_u.shape[1]
    lq = point.model.quadratic
    jacobians, _, rest = lq.stages.split([n * (n + m), n + m, n * n + m * n + m * m + m], 1)
    of_x = torch.cat([torch.zeros_like(grad_x[:1]), -grad_x[:-1]])
    stages = torch.cat([jacobians, of_x, -grad_u, rest], 1)
    return LinearQuadratic(stages, torch.cat([-grad_x[-1], lq.final[n:]]))


def _pulled(
    point: StationaryPoint, dual: Stationary, grad_u: Tensor, grad_cost: Tensor
) -> Float[Tensor, "T m N"]:
    """Derivative by the controls that a bound holds; zero where it is free."""
    n, m = point.x.shape[1], grad_u.shape[1]
    _, B, _, _, _, ux, uu, _ = unpack(point.model.quadratic.stages, *stage_shapes(n, m))
    before = torch.cat([torch.zeros_like(dual.x[:1]), dual.x[:-1]])
    moved = (ux * before.unsqueeze(1)).sum(2) + (uu * dual.u.unsqueeze(1)).sum(2)
    moved = moved + (B * dual.costate.unsqueeze(2)).sum(1)
    slope = grad_u - moved + grad_cost * point.model.gradient
    return torch.where(point.free, torch.zeros_like(slope), slope)


def attach(
    dynamics: Dynamics,
    cost: Cost,
    state: Float[Tensor, "*b n"],
    box: Float[Tensor, "2 m"],
    point: StationaryPoint,
    solve: Solve = solve_free,
) -> Attached | None:
    """Give a stationary point its derivatives in state, box, and all that the callables depend on.

    The derivative of the cost is that of the Lagrangian at fixed z and λ (envelope theorem).
    Problems that are not valid get a gradient of exactly zero. No value changes.

    Returns:
        The point with its graph, or None if nothing here requires a gradient.
    """
    like = state.detach()[..., 0]
    valid = from_batch_last(point.valid, like)
    state = torch.where(valid.unsqueeze(-1), state, from_batch_last(point.x[0], like))
    x, u, start = from_batch_last(point.x[1:], like), from_batch_last(point.u, like), state
    index = lenders(valid)
    if index is not None:
        x, u, start = x[index], u[index], state[index]
        dynamics, cost = lent(dynamics, index), lent(cost, index)
    costates = torch.where(point.valid, point.model.costates, torch.zeros_like(point.x[1:]))
    multipliers = from_batch_last(costates, like)

    def lagrangian(x: Tensor, u: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        states = joined(start, x)
        following = step_all(dynamics, states[..., :-1, :], u)
        each = cost(states, pad_controls(u)).sum(-1) + (multipliers * (following - x)).sum((-2, -1))
        return each.sum(), (each, following)

    (of_x, of_u), (each, following) = torch.func.grad(lagrangian, (0, 1), has_aux=True)(x, u)
    residual = [to_batch_last(part, like) for part in (of_x, of_u, following, each)]
    lower, upper = box.unsqueeze(-1)
    held = torch.where(point.u >= upper, upper, lower)
    if not any(part.requires_grad for part in (*residual, held)):
        return None
    if not point.exact:
        with torch.no_grad():
            point = point._replace(model=expand(dynamics, cost, like, point.x, point.u))
    found = _Implicit.apply(*residual, held, point, solve)
    x, u, total = (from_batch_last(part, like) for part in found)
    return Attached(joined(state, x), u, total)


def joined(state: Float[Tensor, "*b n"], x: Float[Tensor, "*b T n"]) -> Float[Tensor, "*b T1 n"]:
    """Initial and following states."""
    return torch.cat([state.unsqueeze(-2), x], -2)
