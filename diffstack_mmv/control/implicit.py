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

from diffstack_mmv.control.batch_last import from_batch_last, to_batch_last
from diffstack_mmv.control.expansion import Model, expand, pad_controls, step_all
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.riccati import LinearQuadratic, Stationary, solve_free

Solve = Callable[[LinearQuadratic, Tensor, int], Stationary]


class StationaryPoint(NamedTuple):
    """Converged trajectories, constants of the differentiation."""

    x: Float[Tensor, "T1 n N"]
    u: Float[Tensor, "T m N"]
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
    """z* as a function of the KKT residual: dz* = -K⁻¹ dR the active controls on their bounds."""

    @staticmethod
    def forward(
        ctx: Any,
        of_x: Tensor,
        of_u: Tensor,
        following: Tensor,
        point: StationaryPoint,
        solve: Solve,
    ) -> tuple[Tensor, Tensor]:
        ctx.point, ctx.solve = point, solve
        return point.x[1:].clone(), point.u.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_x: Tensor, grad_u: Tensor) -> tuple[Tensor | None, ...]:
        point: StationaryPoint = ctx.point
        lq, n = point.model.quadratic, grad_x.shape[1]
        m = grad_u.shape[1]
        jacobians, _, rest = lq.stages.split([n * (n + m), n + m, n * n + m * n + m * m + m], 1)
        of_x = torch.cat([torch.zeros_like(grad_x[:1]), -grad_x[:-1]])
        adjoint = LinearQuadratic(
            torch.cat([jacobians, of_x, -grad_u, rest], 1), torch.cat([-grad_x[-1], lq.final[n:]])
        )
        dual = ctx.solve(adjoint, point.free.to(grad_u.dtype), n)
        # where, not a product: the adjoint of a problem that did not converge may be anything
        parts = (torch.where(point.valid, -part, torch.zeros_like(part)) for part in dual)
        return *parts, None, None


def attach(
    dynamics: Dynamics,
    cost: Cost,
    state: Float[Tensor, "*b n"],
    point: StationaryPoint,
    solve: Solve = solve_free,
) -> Attached | None:
    """Give a stationary point its derivatives in the state and in all that the callables depend on.

    The derivative of the cost is that of the Lagrangian at fixed z and λ (envelope theorem).
    Problems that are not valid get a gradient of exactly zero.

    Returns:
        The point with its graph, or None if nothing here requires a gradient.
    """
    like = state.detach()[..., 0]
    valid = from_batch_last(point.valid, like)
    state = torch.where(valid.unsqueeze(-1), state, from_batch_last(point.x[0], like))
    x, u = from_batch_last(point.x[1:], like), from_batch_last(point.u, like)
    costates = torch.where(point.valid, point.model.costates, torch.zeros_like(point.x[1:]))
    multipliers = from_batch_last(costates, like)

    def lagrangian(x: Tensor, u: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        states = torch.cat([state.unsqueeze(-2), x], -2)
        following = step_all(dynamics, states[..., :-1, :], u)
        each = cost(states, pad_controls(u)).sum(-1) + (multipliers * (following - x)).sum((-2, -1))
        return each.sum(), (each, following)

    (of_x, of_u), (each, following) = torch.func.grad(lagrangian, (0, 1), has_aux=True)(x, u)
    residual = [to_batch_last(part, like) for part in (of_x, of_u, following)]
    if not any(part.requires_grad for part in residual):
        return None
    if not point.exact:
        with torch.no_grad():
            point = point._replace(model=expand(dynamics, cost, like, point.x, point.u))
    x, u = (from_batch_last(part, like) for part in _Implicit.apply(*residual, point, solve))
    return attached(state, x, u, each, valid)


def attached(
    state: Float[Tensor, "*b n"],
    x: Float[Tensor, "*b T n"],
    u: Float[Tensor, "*b T m"],
    each: Float[Tensor, "*b"],
    valid: Bool[Tensor, "*b"],
) -> Attached:
    """Join initial and following states; only valid problems have a derivative of the cost."""
    states = torch.cat([state.unsqueeze(-2), x], -2)
    return Attached(states, u, torch.where(valid, each, each.detach()))
