"""A primal-dual interior-point method with free states.

States and controls are unknowns and the dynamics one more equation (direct multiple shooting), so
that a state may leave an obstacle before the controls can follow: it finds a way where a method
that only moves controls stays between obstacles. Each iteration is one Newton step on the
optimality conditions with complementarity s z = μ, slacks and states eliminated, the Hessian
shifted until it is positive definite, and a line search with a filter.

Source: Wächter and Biegler, On the implementation of an interior-point filter line-search algorithm
for large-scale nonlinear programming, Mathematical Programming 106, 2006, without its restoration
phase; Vanroye et al., FATROP, IROS 2023, for trajectories.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.barrier import Barrier, BarrierResidual, Interior
from diffstack_mmv.control.constrained.barrier_rows import barrier_rows
from diffstack_mmv.control.constrained.barrier_step import newton
from diffstack_mmv.control.constrained.filter import Accepted, Visited, search
from diffstack_mmv.control.constrained.local import Local, Problem, expand_problem
from diffstack_mmv.control.expansion import expand_cost, pad_controls
from diffstack_mmv.control.selection import SMALLEST

FIRST = 0.1  # barrier parameter μ, for a cost whose gradient is scaled to STEEPEST
FINE, COARSE = 0.7, 0.4  # powers of the precision that are the last μ: 1e-11, 5e-7 in float64
STEEPEST, DEAREST = 10.0, 100.0  # of the scaled cost: largest gradient, largest price
REDUCTION, POWER = 0.2, 1.5
ENOUGH, AT_LAST = 10.0, 30.0  # units of μ that a problem is solved to, at the last μ with rounding
NEAR = 1e-4  # μ from which on the active set may be known, should the last μ not be reached
INSIDE = 1e-2  # of the box, distance of the first controls from the bounds; smallest first slack
DECAY, LIFT = 0.3, 30.0  # of the shift, after a step and after none


class Central(NamedTuple):
    """Where each problem stands on the way along the central path."""

    point: Interior
    kept: Interior  # the last point that solved the problem of its μ
    near: Bool[Tensor, "*b"]  # whether that μ was small
    last: Float[Tensor, "*b"]  # μ at which a problem is finished
    mu: Float[Tensor, "*b"]
    shift: Float[Tensor, "*b"]
    started: Bool[Tensor, "*b"]  # whether all was finite at the guess
    open: Bool[Tensor, "*b"]
    solved: Bool[Tensor, "*b"]
    iterations: Int[Tensor, "*b"]
    visited: Visited

    def select(self, index: Int[Tensor, " k"]) -> "Central":
        """Some of the problems of a batch with one leading dimension."""
        points = [Interior(*(part[index] for part in each)) for each in self[:2]]
        visited = Visited(*(part[:, index] for part in self.visited))
        return Central(*[*points, *(part[index] for part in self[2:-1]), visited])


class Found(NamedTuple):
    """What the method ends with."""

    u: Float[Tensor, "*b T m"]
    multipliers: Float[Tensor, "*b T1 K"]
    solved: Bool[Tensor, "*b"]
    near: Bool[Tensor, "*b"]  # solved, or the last μ is one that rounding does not let it reach
    started: Bool[Tensor, "*b"]  # whether all was finite at the guess
    iterations: Int[Tensor, "*b"]

    def replaced(self, index: Int[Tensor, " k"], part: "Found") -> "Found":
        """With the problems `index` of a batch with one leading dimension taken from `part`."""
        pairs = zip(self, part, strict=True)
        return Found(*(whole.index_copy(0, index, new) for whole, new in pairs))


def follow(
    problem: Problem,
    u: Float[Tensor, "*b T m"],
    most: int,
    which: Bool[Tensor, "*b"],
    accuracy: float = FINE,
) -> Found:
    """Follow the central path from a guess of the controls, at most `most` iterations.

    Only the problems `which` are iterated; `accuracy` is the power of the precision at the end.
    """
    barrier, central = enter(problem, u)
    last = torch.full_like(central.mu, torch.finfo(u.dtype).eps ** accuracy)
    return _run(barrier, central._replace(open=central.open & which, last=last), most)


def _run(barrier: Barrier, central: Central, most: int) -> Found:
    """Iterate; once half of the problems are finished the others go on alone, if they can."""
    for iteration in range(most):
        keep = central.open.flatten().nonzero().squeeze(-1)
        if len(keep) == 0:
            break
        if barrier.problem.selectable and 2 * len(keep) <= len(central.open) > SMALLEST:
            part = _run(barrier.select(keep), central.select(keep), most - iteration)
            return _found(barrier, central).replaced(keep, part)
        central = _iterate(barrier, central)
    return _found(barrier, central)


def _found(barrier: Barrier, central: Central) -> Found:
    early = (~central.solved & central.near)[..., None, None]
    pairs = zip(central.kept, central.point, strict=True)
    point = Interior(*(torch.where(early, kept, last) for kept, last in pairs))
    multipliers = barrier.multipliers(point) / barrier.scale[..., None, None]
    near = central.solved | central.near
    return Found(point.u, multipliers, central.solved, near, central.started, central.iterations)


def enter(problem: Problem, u: Float[Tensor, "*b T m"]) -> tuple[Barrier, Central]:
    """A point inside of all inequalities, its states those of the controls."""
    low, high = problem.bounds
    unit = torch.where((high - low).isfinite(), high - low, torch.ones_like(low))
    margin = INSIDE * torch.where(low < high, unit, torch.zeros_like(low))
    u = u.clamp(low + margin, high - margin)
    x = problem.rollout(u)
    of_x, of_u, _ = expand_cost(problem.cost, x, pad_controls(u))
    steep = torch.maximum(of_x.abs().amax((-2, -1)), of_u.abs().amax((-2, -1)))
    linear = problem.rows.linear
    dear = torch.where(linear.isfinite(), linear, torch.zeros_like(linear)).amax((-2, -1))
    steep = torch.maximum(steep, STEEPEST / DEAREST * dear)
    scale = torch.where(steep > 0, STEEPEST / steep, torch.ones_like(steep)).nan_to_num(1.0)
    values, rows = problem.rows.values(x, pad_controls(u)), barrier_rows(problem.rows)
    g = rows.inequalities(values)
    # a limit at infinity never acts, and nothing can be computed with its slack
    rows = rows._replace(applies=rows.applies & (g != -torch.inf))
    g, barrier = torch.where(rows.applies, g, 0.0), Barrier(problem, rows, scale)
    zero, mu = torch.zeros_like(g), torch.full_like(scale, FIRST)
    sigma = torch.where(barrier.yields, g.clamp_min(0) + _first_violation(barrier), zero)
    s = (sigma - g).clamp_min(INSIDE)
    z = torch.where(barrier.rows.applies, FIRST / s, zero)
    y = values.new_zeros(*values.shape[:-1], len(barrier.rows.equality))
    start = Interior(x, u, s, sigma, zero, y, torch.zeros_like(u), torch.zeros_like(u))
    z = torch.where(barrier.yields, torch.minimum(z, 0.5 * barrier.spare(start)), z)
    below, above = barrier.gaps(u)
    start = start._replace(z=z, lower=FIRST / below, upper=FIRST / above)
    finite = x.isfinite().all(-1).all(-1) & steep.isfinite() & g.isfinite().all(-1).all(-1)
    count = torch.zeros_like(scale, dtype=torch.long)
    none = torch.zeros_like(finite)
    nowhere = Visited(scale.new_zeros(0, *scale.shape), scale.new_zeros(0, *scale.shape))
    return barrier, Central(
        start, start, none, mu, mu, torch.zeros_like(scale), finite, finite, none, count, nowhere
    )


def _first_violation(barrier: Barrier) -> Float[Tensor, "*b T1 I"]:
    """σ with σ (w₁ + w₂ σ) = μ: at a low price a smaller one is far from the central path."""
    scale = barrier.scale[..., None, None]
    linear, quadratic = scale * barrier.rows.linear, scale * barrier.rows.quadratic
    root = (linear.square() + 4 * FIRST * quadratic).sqrt()
    return (2 * FIRST / (linear + root)).clamp_min(INSIDE)


def _iterate(barrier: Barrier, central: Central) -> Central:
    point, open_ = central.point, central.open
    local = expand_problem(_scaled(barrier), point.x, point.u, barrier.multipliers(point))
    residual = barrier.residual(point)
    central = _lowered(central, *_errors(barrier, local, point, residual))
    found = newton(barrier, local, point, residual, central.mu, central.shift, central.open)
    accepted = search(
        barrier, central.visited, point, found.step, residual, central.mu, central.open
    )
    taken = accepted.taken
    less = torch.where(found.shift < 1e-6, torch.zeros_like(found.shift), DECAY * found.shift)
    more = (LIFT * found.shift).clamp_min(1e-2)
    shift = torch.where(taken, less, more)
    lost = ~found.step.u.isfinite().all(-1).all(-1) | (shift > 1e10)
    return central._replace(
        point=accepted.point,
        shift=torch.where(central.open, shift, central.shift),
        visited=_remembered(central.visited, accepted),
        open=central.open & ~lost,
        iterations=central.iterations + open_,
    )


def _remembered(visited: Visited, accepted: Accepted) -> Visited:
    violation = torch.where(accepted.taken, accepted.violation, torch.inf)
    return Visited(
        torch.cat([visited.violation, violation.unsqueeze(0)]),
        torch.cat([visited.objective, accepted.objective.unsqueeze(0)]),
    )


def _scaled(barrier: Barrier) -> Problem:
    problem, scale = barrier.problem, barrier.scale.unsqueeze(-1)

    def cost(states: Tensor, controls: Tensor) -> Tensor:
        return scale * problem.cost(states, controls)

    return problem._replace(cost=cost)


def _errors(
    barrier: Barrier, local: Local, point: Interior, residual: BarrierResidual
) -> tuple[Tensor, list[Tensor]]:
    """Largest residual of the equations without μ, and the products that have to be μ."""
    slope = local.gradient.view(point.u.shape) - point.lower + point.upper
    low, high = barrier.problem.bounds
    slope = torch.where(low < high, slope, torch.zeros_like(slope))
    parts = [part.abs().flatten(-2).amax(-1) for part in (slope, *residual) if part.numel()]
    below, above = barrier.gaps(point.u)
    products = [
        torch.where(below.isfinite(), below * point.lower, torch.nan),
        torch.where(above.isfinite(), above * point.upper, torch.nan),
        torch.where(barrier.rows.applies, point.s * point.z, torch.nan),
        torch.where(barrier.yields, point.sigma * barrier.spare(point), torch.nan),
    ]
    return torch.stack(parts).amax(0), products


def _lowered(central: Central, error: Tensor, products: list[Tensor]) -> Central:
    """Lower μ where its problem is solved well enough; at the last one a problem is finished."""
    mu, last = central.mu, central.last
    solved = near = torch.zeros_like(central.open)
    for _ in range(4):
        away = [(p - mu[..., None, None]).abs().nan_to_num(0.0).flatten(-2) for p in products]
        total = torch.maximum(error, torch.cat(away, -1).amax(-1))
        close = total <= torch.where(mu <= last, AT_LAST, ENOUGH) * mu
        less = torch.maximum(torch.minimum(REDUCTION * mu, mu**POWER), last)
        solved = close & (mu <= last) & central.open
        near = near | (close & (mu <= NEAR) & central.open)
        mu = torch.where(close & central.open, less, mu)
    forgotten = torch.where(mu < central.mu, torch.inf, central.visited.violation)
    pairs = zip(central.point, central.kept, strict=True)
    kept = Interior(*(torch.where(near[..., None, None], new, old) for new, old in pairs))
    return central._replace(
        kept=kept,
        near=central.near | near,
        mu=mu,
        open=central.open & ~solved,
        solved=central.solved | solved,
        visited=central.visited._replace(violation=forgotten),
    )
