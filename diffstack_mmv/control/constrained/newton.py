"""Newton's method on the optimality conditions, the active set taken from the present point.

The augmented Lagrangian comes near a solution and finds out what is active there; this brings it to
the precision of the machine in a few steps. A row of constraints is active where ν + κ g is
positive, a bound where the Lagrangian presses on it (a semismooth Newton method).

Source: Hintermüller, Ito and Kunisch, The primal-dual active set strategy as a semismooth Newton
method, SIAM J. Optimization 13, 2002.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.activity import Activity, classify
from diffstack_mmv.control.constrained.condensed import assemble, chunks, condense, is_convex
from diffstack_mmv.control.constrained.local import Local, Problem, expand_problem
from diffstack_mmv.control.expansion import pad_controls

STEPS = 12
NEAR = 0.3  # cost of the first step relative to that of the problem, above which it is none to take
ROUNDING = 8.0  # units of the precision within which a control is on its bound
GROWTH = 10.0  # of that number from step to step, above which the method has failed


class PrimalDual(NamedTuple):
    """Controls and multipliers."""

    u: Float[Tensor, "*b T m"]
    multipliers: Float[Tensor, "*b T1 K"]


class NewtonStep(NamedTuple):
    """One step and what it promises."""

    u: Float[Tensor, "N P"]
    multipliers: Float[Tensor, "N R"]
    size: Float[Tensor, " N"]  # Σ |M_ii| δu_i² / Σ|c|, free of all units
    pull: Float[Tensor, " N"]  # steepest descent, relative to Σ|c|, in a control without curvature
    convex: Bool[Tensor, " N"]


class Polished(NamedTuple):
    """Where Newton's method ended."""

    point: PrimalDual
    solved: Bool[Tensor, "*b"]
    began: Bool[Tensor, "*b"]  # at a point without violation that is a strict minimum
    steps: Int[Tensor, "*b"]


def polish(
    problem: Problem,
    start: PrimalDual,
    activation: Float[Tensor, "*b 1 K"],
    chosen: Bool[Tensor, "*b"],
    accuracy: Float[Tensor, ""],
    tolerance: Float[Tensor, ""],
) -> Polished:
    """Iterate the chosen problems to a solution or give them up.

    A problem is solved once two steps in a row are below the accuracy, without violation above the
    tolerance, at a point that is a strict minimum along the active constraints. Steps in a control
    without curvature have no size: the Lagrangian may not descend in it either.

    Args:
        problem: All problems.
        start: Where they begin.
        activation: κ of each constraint.
        chosen: Which problems to iterate; the others stay.
        accuracy: Size of a step that counts as none.
        tolerance: Violation that counts as none.
    """
    point, open_ = start, chosen
    solved, steps = torch.zeros_like(chosen), torch.zeros_like(chosen, dtype=torch.long)
    began = torch.zeros_like(chosen)
    small, before = (
        torch.zeros_like(chosen),
        torch.zeros_like(problem.state[..., 0]) + NEAR / GROWTH,
    )
    for count in range(STEPS):
        if not bool(open_.any()):
            break
        x = problem.rollout(point.u)
        values = problem.rows.values(x, pad_controls(point.u))
        activity = classify(point.multipliers + activation * values, problem.rows)
        multipliers = activity.multipliers(point.multipliers)
        local = expand_problem(problem, x, point.u, multipliers)
        step = newton_step(problem, local, activity, point.u, multipliers, values, open_)
        size, pull, convex = (part.view(open_.shape) for part in step[2:])
        tiny = torch.maximum(accuracy, (local.noise / local.magnitude).nan_to_num(0.0)).view(
            open_.shape
        )
        was_small, small = small, size <= tiny
        clear = problem.rows.violation(values) <= tolerance
        good = open_ & clear & convex & (pull <= ROUNDING * tiny)
        began = good if count == 0 else began
        failed = ~(size <= torch.maximum(GROWTH * before, tiny))
        steps = steps + open_
        point = _moved(problem, point, multipliers, step, open_ & ~failed)
        solved = solved | (small & was_small & good)
        open_ = open_ & ~failed & ~solved
        before = size
    return Polished(point, solved, began, steps)


def _moved(
    problem: Problem, point: PrimalDual, multipliers: Tensor, step: NewtonStep, which: Tensor
) -> PrimalDual:
    lower, upper = problem.bounds
    u = point.u + step.u.view(point.u.shape)
    near = ROUNDING * torch.finfo(u.dtype).eps
    u = torch.where(u <= lower + near * lower.abs(), lower, u)
    u = torch.where(u >= upper - near * upper.abs(), upper, u)
    pressed = multipliers + step.multipliers.view(multipliers.shape)
    mask = which[..., None, None]
    return PrimalDual(torch.where(mask, u, point.u), torch.where(mask, pressed, point.multipliers))


def free_controls(
    problem: Problem, u: Float[Tensor, "*b T m"], gradient: Float[Tensor, "N T m"]
) -> Bool[Tensor, "N P"]:
    """Which controls no bound holds: one holds that is reached, with pressure on it."""
    lower, upper = (bound.detach().to(u) for bound in problem.bounds)
    u = u.reshape(gradient.shape)
    active = ((u <= lower) & (gradient > 0)) | ((u >= upper) & (gradient < 0)) | (lower == upper)
    return ~active.flatten(1)


def _reached_bound(problem: Problem, u: Tensor, gradient: Tensor, weight: Tensor) -> Tensor:
    """The bound that a step along the scaled gradient reaches, NaN where there is none."""
    lower, upper = (bound.repeat(u.shape[1] // len(bound)) for bound in problem.bounds)
    goal = u - gradient / weight
    none = torch.full_like(u, torch.nan)
    reached = torch.where(goal > upper, upper, torch.where(goal < lower, lower, none))
    return torch.where(lower == upper, lower, reached)


def newton_step(
    problem: Problem,
    local: Local,
    activity: Activity,
    u: Float[Tensor, "*b T m"],
    multipliers: Float[Tensor, "*b T1 K"],
    values: Float[Tensor, "*b T1 K"],
    which: Bool[Tensor, "*b"],
) -> NewtonStep:
    """The step of the problems `which`, zero for all others."""
    N, P = len(local.B), u.shape[-2] * u.shape[-1]
    flat = u.reshape(N, P)
    residual = activity.residual(values, multipliers).reshape(N, -1)
    active, compliance = activity.active.reshape(N, -1), activity.compliance.reshape(N, -1)
    du, dv = local.B.new_zeros(N, P), torch.zeros_like(residual)
    size, pull = local.B.new_zeros(2, N)
    convex = torch.zeros(N, dtype=torch.bool, device=u.device)
    for index in chunks(which.reshape(N)):
        condensed = condense(local.select(index))
        weight = condensed.hessian.diagonal(dim1=1, dim2=2).abs()
        gradient = local.gradient[index].flatten(1)
        goal = _reached_bound(problem, flat[index], gradient, weight)
        fixed = torch.where(goal.isnan(), 0.0, goal - flat[index])
        kept = goal.isnan(), active[index], compliance[index]
        system = assemble(condensed, *kept)
        moved = (condensed.hessian @ fixed.unsqueeze(-1)).squeeze(-1)
        along = (condensed.jacobian @ fixed.unsqueeze(-1)).squeeze(-1)
        own_u, own_v = system.solve(-gradient - moved, -residual[index] - along)
        own_u = own_u + fixed
        du[index], dv[index], convex[index] = own_u, own_v, is_convex(condensed, *kept)
        magnitude = local.magnitude[index].clamp_min(torch.finfo(u.dtype).tiny)
        size[index] = (weight * own_u.square()).sum(1) / magnitude
        steep = torch.where(goal.isnan() & (weight == 0), gradient.abs(), 0.0)
        pull[index] = (steep * (1 + flat[index].abs())).amax(1) / magnitude
    return NewtonStep(du, dv, size, pull, convex)
