"""The loop over inner solves, multiplier updates and Newton's method."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from diffstack_mmv.control.constrained.augmented import augmented
from diffstack_mmv.control.constrained.infeasibility import is_trapped
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.newton import Point, polish
from diffstack_mmv.control.constrained.outer import Progress, updated
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.ilqr import ILQR
from diffstack_mmv.control.selection import SMALLEST
from diffstack_mmv.types import SolverStatus

LOOSE = 1e-6  # tolerance of the inner solver while the multipliers are still on their way
HOPELESS = 1e3  # growth of the penalty from which on a violation may turn out to stay


class Work(NamedTuple):
    """The problems that are still solved, and where the finished ones wait."""

    problem: Problem
    progress: Progress
    index: Int[Tensor, " k"] | None  # of the solved problems among all; None: all
    whole: Progress

    def merged(self) -> Progress:
        """All problems, the solved ones as they stand now."""
        index = self.index
        if index is None:
            return self.progress
        pairs = zip(self.whole, self.progress, strict=True)
        return Progress(*(old.index_copy(0, index, new) for old, new in pairs))

    def narrowed(self) -> "Work":
        """Only the open problems, if the callables can follow and half or more are finished."""
        is_open = self.progress.is_open
        if not self.problem.selectable or len(is_open) <= SMALLEST or is_open.is_cuda:
            return self
        keep = is_open.nonzero().squeeze(-1)
        if 2 * len(keep) > len(is_open):
            return self
        index = keep if self.index is None else self.index[keep]
        part = Progress(*(field[keep] for field in self.progress))
        return Work(self.problem.select(keep), part, index, self.merged())


@dataclass(frozen=True)
class Rounds:
    """The settings of the loop, see `ConstrainedILQR`."""

    solver: ILQR
    most: int
    tolerance: float

    def run(self, problem: Problem, progress: Progress, warm: bool) -> Progress:
        """Iterate until every problem is finished; a warm start tries Newton's method first."""
        if warm:
            progress = self._polished(problem, progress, progress.is_open)
        work = Work(problem, progress, None, progress)
        for number in range(self.most):
            work = work.narrowed()
            if not bool(work.progress.is_open.any()):
                break
            is_late = 2 * number >= self.most
            work = work._replace(progress=self._round(work.problem, work.progress, is_late))
        progress = work.merged()
        limit = torch.where(progress.is_open, SolverStatus.ITERATION_LIMIT, progress.status)
        return progress._replace(status=limit)

    def _round(self, problem: Problem, progress: Progress, is_late: bool) -> Progress:
        loose = self.solver.tolerance if is_late else max(self.solver.tolerance, LOOSE)
        cost = augmented(problem.cost, problem.rows, progress.multipliers, progress.penalty)
        solver = replace(self.solver, tolerance=loose)
        inner = solver(problem.dynamics, cost, problem.bounds, problem.state, progress.u)
        values = problem.rows.values(inner.states, pad_controls(inner.controls))
        tolerance = problem.state.new_tensor(self.tolerance)
        progress = updated(progress, problem.rows, inner, values, tolerance)
        progress = self._polished(problem, progress, progress.is_open & inner.converged)
        met = (progress.error <= tolerance) & (progress.violation <= tolerance)
        done = progress.is_open & met & inner.converged & is_late
        status = torch.where(done, SolverStatus.CONVERGED, progress.status)
        return self._judged(problem, progress._replace(status=status))

    def _polished(
        self, problem: Problem, progress: Progress, chosen: Bool[Tensor, "*b"]
    ) -> Progress:
        """Newton's method where it may help; what it solves is finished."""
        like = problem.state
        start = Point(progress.u, progress.multipliers)
        accuracy = like.new_tensor(self.solver.tolerance)
        tolerance = like.new_tensor(self.tolerance)
        polished = polish(problem, start, progress.penalty, chosen, accuracy, tolerance)
        done = progress._replace(
            u=polished.point.u,
            multipliers=polished.point.multipliers,
            status=torch.full_like(progress.status, SolverStatus.CONVERGED),
        )
        return progress.kept_where(polished.solved, done)

    def _judged(self, problem: Problem, progress: Progress) -> Progress:
        """A problem whose violation no step lowers is infeasible."""
        doubtful = progress.is_open & (progress.growth >= HOPELESS)
        doubtful = doubtful & (progress.violation > self.tolerance)
        if not bool(doubtful.any()):
            return progress
        trapped = doubtful & is_trapped(problem, progress.u)
        status = torch.where(trapped, SolverStatus.INFEASIBLE, progress.status)
        return progress._replace(status=status)


