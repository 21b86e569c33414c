"""Where the problems of a batch stand between the phases of a solve."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.newton import PrimalDual
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.iteration import OPEN
from diffstack_mmv.types import SolverStatus


class Merit(NamedTuple):
    """What controls are judged by: the violation first, then the cost."""

    violation: Float[Tensor, "*b"]  # largest one of a hard constraint
    cost: Float[Tensor, "*b"]  # with the price of violated soft constraints

    def exceeds(self, other: "Merit", tolerance: float) -> Bool[Tensor, "*b"]:
        """Where these controls are worse than others; violations within the tolerance are none."""
        mine, theirs = (each.violation.clamp_min(tolerance) for each in (self, other))
        return (mine > theirs) | ((mine == theirs) & (self.cost > other.cost))


class Progress(NamedTuple):
    """The end of each finished problem, the best controls so far of each open one."""

    u: Float[Tensor, "*b T m"]
    multipliers: Float[Tensor, "*b T1 K"]
    merit: Merit
    status: Int[Tensor, "*b"]
    iterations: Int[Tensor, "*b"]

    @property
    def is_open(self) -> Bool[Tensor, "*b"]:
        """Which problems are still being solved."""
        return self.status == OPEN

    def finished(
        self, mask: Bool[Tensor, "*b"], point: PrimalDual, status: SolverStatus
    ) -> "Progress":
        """With the problems of the mask finished at a point."""
        moved = self._at(mask, point)
        return moved._replace(status=torch.where(mask, int(status), self.status))

    def offered(self, problem: Problem, point: PrimalDual, tolerance: float) -> "Progress":
        """With the open problems at a point where it is better than the one before."""
        merit = judge(problem, point.u)
        better = self.is_open & self.merit.exceeds(merit, tolerance)
        pairs = zip(merit, self.merit, strict=True)
        best = Merit(*(torch.where(better, new, old) for new, old in pairs))
        return self._at(better, point)._replace(merit=best)

    def counted(self, iterations: Int[Tensor, "*b"]) -> "Progress":
        """With the iterations of a phase added to the open problems."""
        return self._replace(iterations=self.iterations + iterations * self.is_open)

    def _at(self, mask: Bool[Tensor, "*b"], point: PrimalDual) -> "Progress":
        pairs = zip(point, (self.u, self.multipliers), strict=True)
        u, multipliers = (torch.where(mask[..., None, None], new, old) for new, old in pairs)
        return self._replace(u=u, multipliers=multipliers)


def begin(problem: Problem, guess: Float[Tensor, "*b T m"]) -> Progress:
    """Progress at a guess of the controls."""
    count = torch.zeros(guess.shape[:-2], dtype=torch.long, device=guess.device)
    none = torch.zeros_like(problem.rows.linear)
    return Progress(guess, none, judge(problem, guess), count + OPEN, count)


def judge(problem: Problem, u: Float[Tensor, "*b T m"]) -> Merit:
    """Violation and cost of controls, infinite where they are not finite."""
    x, acting = problem.rollout(u), pad_controls(u)
    values, rows = problem.rows.values(x, acting), problem.rows
    cost = problem.cost(x, acting).sum(-1) + rows.paid(rows.excess(values))
    finite = x.isfinite().all(-1).all(-1)
    merit = Merit(rows.violation(values), cost)
    return Merit(*(torch.where(finite & part.isfinite(), part, torch.inf) for part in merit))
