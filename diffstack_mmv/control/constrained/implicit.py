"""Derivatives of a constrained solution by the implicit function theorem, the active set fixed.

As in `diffstack_mmv.control.implicit`, with two kinds of equations more in the residual: the rows
of active constraints, g(x, u) less the slack of their multiplier, and the active bounds,
u - bound. The KKT matrix is symmetric, so that the backward pass is one linear-quadratic problem
with homogeneous constraints. A row that is weakly active, without a multiplier that counts, is
treated as inactive: the derivative is that of the side on which it does not act.
"""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.constrained.activity import Activity
from diffstack_mmv.control.constrained.condensed import Condensed, assemble, chunks, condense
from diffstack_mmv.control.constrained.local import Local, Problem, adjoint_states
from diffstack_mmv.control.expansion import pad_controls, step_all
from diffstack_mmv.control.implicit import Attached, joined
from diffstack_mmv.control.once import Once
from diffstack_mmv.control.selection import lenders

WEAK = 1e-6  # of the root of the cost that letting go of a row would save; below, it is inactive


class KktPoint(NamedTuple):
    """Solutions, constants of the differentiation; flattened to one leading dimension."""

    x: Float[Tensor, "N T1 n"]
    u: Float[Tensor, "N T m"]
    cost: Float[Tensor, " N"]
    multipliers: Float[Tensor, "N T1 K"]
    slack: Float[Tensor, "N T1 K"]  # violation of the rows that give way
    activity: Activity
    signed: Bool[Tensor, " K"]
    free: Bool[Tensor, "N P"]
    valid: Bool[Tensor, " N"]  # problems that carry a gradient
    local: Local


class AttachedRows(NamedTuple):
    """The values of a solution with their derivatives."""

    trajectory: Attached
    multipliers: Float[Tensor, "*b T1 K"]


class Adjoint(NamedTuple):
    """Solution of the adjoint system: derivatives by each part of the residual."""

    x: Float[Tensor, "N T n"]
    u: Float[Tensor, "N T m"]
    following: Float[Tensor, "N T n"]
    rows: Float[Tensor, "N T1 K"]
    bounds: Float[Tensor, "N T m"]


class _ImplicitRows(torch.autograd.Function):
    """(x, u, ν) as a function of the residual of the optimality conditions."""

    @staticmethod
    def forward(
        ctx: Any,
        of_x: Tensor,
        of_u: Tensor,
        following: Tensor,
        rows: Tensor,
        bounds: Tensor,
        point: KktPoint,
    ) -> tuple[Tensor, Tensor, Tensor]:
        ctx.point = point
        return point.x[:, 1:].clone(), point.u.clone(), point.multipliers.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        point: KktPoint = ctx.point
        like = (*upstream[:2], upstream[0], upstream[2], upstream[1])
        parts = Adjoint(*(torch.zeros_like(part) for part in like))
        for index in chunks(point.valid):
            found = _adjoint(point, index, *(part[index] for part in upstream))
            for whole, part in zip(parts, found, strict=True):
                whole[index] = part
        return *parts, None


def _adjoint(
    point: KktPoint, index: Tensor, grad_x: Tensor, grad_u: Tensor, grad_v: Tensor
) -> Adjoint:
    local, free = point.local.select(index), point.free[index]
    activity = Activity(*(part[index] for part in point.activity))
    condensed = condense(local)
    N, _, _, P = condensed.sensitivity.shape
    active = _pressing(point, index, activity, condensed, local).flatten(1)
    system = assemble(condensed, free, active, activity.compliance.flatten(1))
    G = condensed.sensitivity[:, 1:].reshape(N, -1, P)
    of_u = grad_u.flatten(1) + (G * grad_x.reshape(N, -1, 1)).sum(1)
    grad_v = torch.where(active, grad_v.flatten(1), 0.0)
    du, dv = system.solve(-of_u, -grad_v)
    w_u, w_v = du.view_as(grad_u), dv.view(N, *activity.active.shape[1:])
    w_x = (G @ du.unsqueeze(-1)).view_as(grad_x)
    whole = torch.cat([torch.zeros_like(w_x[:, :1]), w_x], 1)
    curved = _apply(local.xx, whole) + _apply(local.values_x.mT, w_v)
    curved = curved[:, 1:] + pad_controls(_apply(local.ux.mT, w_u))[:, 1:] + grad_x
    costates = adjoint_states(local.A, curved)
    pull = _apply(local.ux, whole[:, :-1]) + _apply(local.uu, w_u) + grad_u
    pull = pull + _apply(local.values_u.mT, w_v[:, :-1]) + _apply(local.B.mT, costates)
    on_bound = torch.where(free.view_as(pull), torch.zeros_like(pull), -pull)
    return Adjoint(w_x, w_u, costates, w_v, on_bound)


def _apply(P: Float[Tensor, "*b a c"], v: Float[Tensor, "*b c"]) -> Float[Tensor, "*b a"]:
    return (P * v.unsqueeze(-2)).sum(-1)


def _pressing(
    point: KktPoint, index: Tensor, activity: Activity, condensed: Condensed, local: Local
) -> Tensor:
    """Held rows, without the inequalities whose release would not lower the cost noticeably."""
    weight = condensed.hessian.diagonal(dim1=1, dim2=2).abs().clamp_min(1e-30)
    leverage = (condensed.jacobian.square() / weight.unsqueeze(1)).sum(-1).sqrt()
    multipliers = point.multipliers[index]
    saved = multipliers.abs() * leverage.view_as(multipliers)
    weak = saved <= WEAK * local.magnitude.sqrt()[:, None, None]
    return activity.active & ~(weak & ~point.signed & (activity.side == 0))


def attach(problem: Problem, point: KktPoint) -> AttachedRows | None:
    """Give solutions their derivatives in everything that the problem depends on.

    The problem comes with the graph of its prices and bounds. The derivative of the cost is that of
    the Lagrangian at fixed trajectories and multipliers (envelope theorem). Problems that are not
    valid get a gradient of exactly zero.

    Returns:
        The solutions with their graph, or None if nothing here requires a gradient.
    """
    whole, u, valid = (problem.unflat(part) for part in (point.x, point.u, point.valid))
    state, x = torch.where(valid.unsqueeze(-1), problem.state, whole[..., 0, :]), whole[..., 1:, :]
    problem = problem._replace(state=state)
    index = lenders(valid) if problem.selectable else None
    if index is not None:
        x, u, problem = x[index], u[index], problem.select(index)
    terms = _Terms(problem, point)
    (of_x, of_u), (each, following, rows) = torch.func.grad(terms.lagrangian, (0, 1), has_aux=True)(
        x, u
    )
    bounds = u - terms.bound
    residual = [problem.flat(part) for part in (of_x, of_u, following, rows, bounds)]
    if not any(part.requires_grad for part in (*residual, each)):
        return None
    *residual, each = Once.apply(*residual, each)
    x, u, rows = (problem.unflat(part) for part in _ImplicitRows.apply(*residual, point))
    multipliers = torch.where(terms.activity.active, rows, terms.multipliers)
    paid = problem.unflat(point.cost)
    # the value is that of the solver, whatever the gradient is asked of
    total = torch.where(valid, paid + (each - each.detach()), paid)
    return AttachedRows(Attached(joined(state, x), u, total), multipliers)


class _Terms:
    """The Lagrangian of a problem with its graph, at constant multipliers."""

    def __init__(self, problem: Problem, point: KktPoint) -> None:
        self.problem, rows, shaped = problem, problem.rows, problem.unflat
        self.valid = shaped(point.valid)[..., None, None]
        self.activity = Activity(*(shaped(part) for part in point.activity))
        yields, side = self.activity.compliance > 0, self.activity.side
        self.acts = self.activity.active | self.activity.saturated
        priced = torch.where(rows.linear.isfinite(), rows.linear, 0.0)
        self.offset = torch.where(self.activity.saturated | yields, side * priced, 0.0)
        self.slack = self._constant(shaped(point.slack))
        # a price of squares that is zero has a derivative as well: it grows by the violation
        pressing = self.offset + side * rows.quadratic * self.slack
        pressing = torch.where(self.valid, pressing, pressing.detach())
        constant = self._constant(shaped(point.multipliers))
        self.multipliers = torch.where(self.activity.saturated, pressing, constant)
        price = torch.where(yields, rows.quadratic, torch.ones_like(side))
        self.compliance = torch.where(yields, 1 / price, 0.0)
        self.prices = priced, rows.quadratic
        self.costates = self._constant(shaped(point.local.costates))
        lower, upper = (bound.to(problem.state) for bound in problem.bounds)
        u, press = shaped(point.u), shaped(point.local.gradient)
        on_bound = ~shaped(point.free).reshape(u.shape)
        side_of = torch.where(u >= upper, upper, lower)
        self.bound = torch.where(on_bound & self.valid, side_of, u)
        self.pressure = self._constant(torch.where(on_bound, -press, torch.zeros_like(press)))

    def _constant(self, part: Tensor) -> Tensor:
        return torch.where(self.valid, part, torch.zeros_like(part))

    def lagrangian(
        self, x: Float[Tensor, "*b T n"], u: Float[Tensor, "*b T m"]
    ) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
        """Sum over the problems; Lagrangian of each, next states and residual of the rows."""
        states = torch.cat([self.problem.state.unsqueeze(-2), x], -2)
        following = step_all(self.problem.dynamics, states[..., :-1, :], u)
        values = self.problem.rows.values(states, pad_controls(u))
        paid = self.prices[0] * self.slack + 0.5 * self.prices[1] * self.slack.square()
        # what never acts may lie at minus infinity, of which no multiplier makes zero
        left = torch.where(self.acts, values - self.activity.side * self.slack, 0.0)
        each = (
            self.problem.cost(states, pad_controls(u)).sum(-1)
            + (self.costates * (following - x)).sum((-2, -1))
            + (self.pressure * (u - self.bound)).sum((-2, -1))
            + torch.where(self.valid, self.multipliers * left + paid, 0.0).sum((-2, -1))
        )
        yielded = self.compliance * (self.multipliers - self.offset)
        rows = torch.where(self.activity.active & self.valid, values - yielded, 0.0)
        return each.sum(), (each, following, rows)
