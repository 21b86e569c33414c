"""Step sizes of the interior-point method: to the boundary, then what a filter accepts."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.constrained.barrier import Barrier, BarrierResidual, Interior

BOUNDARY = 0.99  # of the way to the boundary that a step may go
SIZES = 12  # step sizes, halved each time
MARGIN = 1e-5  # by which a step has to improve on what was there before
FEASIBLE = 1e-8  # sum of violations below which only the objective counts; rounding may be more
ROUNDING = 10.0  # units of the precision of the objective that count as no increase


class Visited(NamedTuple):
    """Pairs that a step has to beat in one of the two; infinite violations are beaten anyway."""

    violation: Float[Tensor, "F ..."]
    objective: Float[Tensor, "F ..."]

    def beaten_by(
        self, violation: Float[Tensor, "*b"], objective: Float[Tensor, "*b"]
    ) -> Bool[Tensor, "*b"]:
        """Whether a pair is better than each of these in violation or objective."""
        less = violation <= (1 - MARGIN) * self.violation
        cheaper = objective <= self.objective - MARGIN * self.violation.nan_to_num(0.0, 0.0)
        return (less | cheaper).all(0)


class Accepted(NamedTuple):
    """The point after a step, and which problems took one."""

    point: Interior
    taken: Bool[Tensor, "*b"]
    violation: Float[Tensor, "*b"]  # before the step
    objective: Float[Tensor, "*b"]


def search(
    barrier: Barrier,
    visited: Visited,
    point: Interior,
    step: Interior,
    residual: BarrierResidual,
    mu: Float[Tensor, "*b"],
    which: Bool[Tensor, "*b"],
) -> Accepted:
    """The longest step of each problem that its filter accepts, none where there is none."""
    primal, dual = longest(barrier, point, step)
    violation, objective = residual.total, barrier.objective(point, mu)
    noise = ROUNDING * torch.finfo(mu.dtype).eps * objective.abs()
    feasible = _rounded_violation(point).clamp_min(FEASIBLE)
    taken, best = torch.zeros_like(which), point
    for _ in range(SIZES):
        trial, total = _slackened(barrier, point.moved(step, primal, dual))
        value = barrier.objective(trial, mu)
        lower = value <= objective + noise
        better = (total <= (1 - MARGIN) * violation) | (value <= objective - MARGIN * violation)
        better = torch.where(violation <= feasible, lower & (total <= 10 * feasible), better)
        good = better & visited.beaten_by(total, value) & value.isfinite() & total.isfinite()
        good = good & which & ~taken
        mask = good[..., None, None]
        best = Interior(*(torch.where(mask, t, b) for t, b in zip(trial, best, strict=True)))
        taken = taken | good
        if bool((taken | ~which).all()):
            break
        primal = 0.5 * primal
    return Accepted(best, taken, violation, objective)


def _rounded_violation(point: Interior) -> Float[Tensor, "*b"]:
    """Sum of violations that is nothing but rounding: no step makes less of it.

    In float64 it is far below `FEASIBLE`.
    """
    size = sum(part.abs().sum((-2, -1)) for part in (point.x, point.s, point.sigma))
    return torch.finfo(point.x.dtype).eps * size  # pyright: ignore


def _slackened(barrier: Barrier, point: Interior) -> tuple[Interior, Tensor]:
    """The point with slacks raised to where the constraints are, and its violation."""
    residual = barrier.residual(point)
    raised = point._replace(s=point.s + (-residual.unequal).clamp_min(0))
    left = residual._replace(unequal=residual.unequal.clamp_min(0))
    return raised, left.total


def longest(barrier: Barrier, point: Interior, step: Interior) -> tuple[Tensor, Tensor]:
    """Largest step sizes of the unknowns and of the multipliers that stay inside, (*b,) each."""
    rows, (below, above) = barrier.rows, barrier.gaps(point.u)
    inner = barrier.yields
    scale = barrier.scale[..., None, None]
    spare_step = scale * rows.quadratic * step.sigma - step.z
    primal = torch.minimum(
        torch.minimum(_reach(below, step.u), _reach(above, -step.u)),
        torch.minimum(_reach(point.s, step.s), _reach(point.sigma, step.sigma, inner)),
    )
    dual = torch.minimum(
        torch.minimum(_reach(point.lower, step.lower), _reach(point.upper, step.upper)),
        torch.minimum(_reach(point.z, step.z), _reach(barrier.spare(point), spare_step, inner)),
    )
    # a price that grows with the violation joins both
    joint = (inner & (rows.quadratic > 0)).flatten(-2).any(-1)
    both = torch.minimum(primal, dual)
    return torch.where(joint, both, primal), torch.where(joint, both, dual)


def _reach(value: Tensor, step: Tensor, among: Tensor | None = None) -> Tensor:
    """Largest size at which value + size · step has not lost BOUNDARY of the value."""
    limits = (step < 0) & (value > 0) & value.isfinite()
    limits = limits if among is None else limits & among
    sizes = torch.where(limits, -BOUNDARY * value / step, torch.ones_like(value))
    if sizes.shape[-1] == 0:
        return sizes.new_ones(sizes.shape[:-2])
    return sizes.amin((-2, -1)).clamp_max(1.0)
