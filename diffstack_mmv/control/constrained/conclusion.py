"""What is returned at the end: no problem gives NaN."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from diffstack_mmv.control.constrained.activity import Activity, classify
from diffstack_mmv.control.constrained.implicit import AttachedRows, KktPoint
from diffstack_mmv.control.constrained.local import Problem, expand_problem
from diffstack_mmv.control.constrained.newton import free_controls
from diffstack_mmv.control.constrained.progress import Progress
from diffstack_mmv.control.constrained.solution import ConstrainedSolution
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.types import SolverStatus


class Conclusion(NamedTuple):
    """The end of all problems: the result, its multipliers in one piece, and what it rests on."""

    point: KktPoint
    parts: tuple[Tensor, ...]
    multipliers: Tensor

    def solution(self, widths: Sequence[int], attached: AttachedRows | None) -> ConstrainedSolution:
        """The result, with its derivatives if there are any; `widths` of each multiplier."""
        x, u, cost, *rest = self.parts
        multipliers = self.multipliers
        if attached is not None:
            (x, u, cost), multipliers = attached
        return ConstrainedSolution(*[x, u, cost, *rest, multipliers.split(list(widths), -1)])


def conclude(problem: Problem, progress: Progress, exact: bool) -> Conclusion:
    """Trajectories, active set, residual and cost at the end.

    Args:
        problem: The problems, without graph.
        progress: How they ended.
        exact: Whether a gradient is taken, which needs derivatives of second order: that of a
            length has none at zero.
    """
    lower, upper = problem.bounds
    u = progress.u.nan_to_num(0.0).clamp(lower, upper)
    x = problem.rollout(u)
    acting = pad_controls(u)
    values = problem.rows.values(x, acting)
    activity = classify(progress.multipliers + values, problem.rows)
    multipliers = activity.multipliers(progress.multipliers).nan_to_num(0.0)
    slack = torch.where(activity.side != 0, values.abs(), torch.zeros_like(values))
    # of an open problem rows may be violated beyond what the multipliers tell
    total = problem.cost(x, acting).sum(-1) + problem.rows.paid(problem.rows.excess(values))
    local = expand_problem(problem, x, u, multipliers)
    gradient = local.gradient.view(u.shape)
    residual = (u - (u - gradient).clamp(lower, upper)).abs().amax((-2, -1))
    finite = x.isfinite().all(-1).all(-1) & total.isfinite() & residual.isfinite()
    if exact:
        for part in local:
            finite = finite & problem.unflat(part.isfinite().unsqueeze(-1).flatten(1).all(1))
    bad = (progress.status == SolverStatus.CONVERGED) & ~finite
    status = torch.where(bad, SolverStatus.NOT_FINITE, progress.status)
    valid = (status == SolverStatus.CONVERGED).reshape(-1)
    x, violation = x.nan_to_num(0.0), problem.rows.violation(values)
    cost, residual, violation = (
        part.nan_to_num(torch.inf, torch.inf) for part in (total, residual, violation)
    )
    flat = (problem.flat(part) for part in (x, u, cost, multipliers, slack.nan_to_num(0.0)))
    active = Activity(*(problem.flat(part) for part in activity))
    free = free_controls(problem, u, local.gradient)
    point = KktPoint(*[*flat, active, problem.rows.signed, free, valid, local])
    parts = (x, u, cost, residual, progress.iterations, status, violation)
    return Conclusion(point, parts, multipliers)
