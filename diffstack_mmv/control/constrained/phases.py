"""The phases of a solve, each for the problems that the one before has left."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.constrained.constraint import ConstraintRows
from diffstack_mmv.control.constrained.interior import COARSE, FINE, Found, enter, follow
from diffstack_mmv.control.constrained.local import Problem, linearise_rows
from diffstack_mmv.control.constrained.newton import PrimalDual, polish
from diffstack_mmv.control.constrained.progress import Progress, begin, judge
from diffstack_mmv.control.expansion import expand_cost, pad_controls
from diffstack_mmv.control.ilqr import ILQR
from diffstack_mmv.types import SolverStatus

PRICES = 1e3, 1e6  # of a violation in the elastic problem, the gradient of the cost being scaled
NARROW = (
    1e-2  # gradient of a constraint relative to the steepest one, below which it counts as that
)
FINEST = 100.0  # violations, in units of the precision, below which none can be told from another


@dataclass(frozen=True)
class Phases:
    """The settings, see `ConstrainedILQR`.

    Args:
        solver: Without constraints, and its tolerance.
        most: Iterations of one phase.
        tolerance: Violation that counts as none.
        exact: Whether only what Newton's method confirms is a solution, as a gradient needs it.
    """

    solver: ILQR
    most: int
    tolerance: float
    exact: bool

    def run(self, problem: Problem, guess: Tensor, start: PrimalDual | None) -> Progress:
        """Solve every problem or find out why not.

        Args:
            problem: The problems, without graph.
            guess: Of the controls, of shape (*b, T, m).
            start: What may be near a solution, which Newton's method tries first.
        """
        progress = begin(problem, guess)
        activation = activation_weight(problem, problem.rollout(guess), guess)
        if start is not None:
            progress = self._polished(problem, progress, start, activation, progress.is_open)
        if bool(progress.is_open.any()):
            progress = self._unconstrained(problem, progress, guess)
        if bool(progress.is_open.any()):
            progress = self._interior(problem, progress, guess, activation)
        for price in PRICES:
            if bool(progress.is_open.any()):
                last = price == PRICES[-1]
                progress = self._elastic(problem, progress, guess, activation, price, last)
        if bool(progress.is_open.any()):
            progress = self._interior(problem, progress, progress.u, activation)
        limit = torch.where(progress.is_open, SolverStatus.ITERATION_LIMIT, progress.status)
        return progress._replace(status=limit)

    def _unconstrained(self, problem: Problem, progress: Progress, guess: Tensor) -> Progress:
        """Finished is where a solution without constraints violates none of them.

        Touching is no violation: a vehicle that stands at its goal and may not reverse stays. So
        is a problem finished that runs off to infinity without violating any.
        """
        dynamics, cost, rows, bounds, state = problem
        plain = self.solver(dynamics, cost, bounds, state, guess)
        values = rows.values(plain.states, pad_controls(plain.controls))
        clear = rows.excess(values) <= FINEST * torch.finfo(values.dtype).eps
        free = progress.is_open & clear.flatten(-2).all(-1)
        progress = progress.counted(plain.iterations)
        point = PrimalDual(plain.controls, torch.zeros_like(values))
        for end in (SolverStatus.CONVERGED, SolverStatus.UNBOUNDED):
            progress = progress.finished(free & (plain.status == end), point, end)
        return progress.offered(problem, point, self.tolerance)

    def _interior(
        self, problem: Problem, progress: Progress, guess: Tensor, activation: Tensor
    ) -> Progress:
        found = self._followed(problem, guess, progress.is_open)
        progress = progress.counted(found.iterations)
        lost = progress.is_open & ~found.started
        at_guess = PrimalDual(guess, torch.zeros_like(progress.multipliers))
        progress = progress.finished(lost, at_guess, SolverStatus.NOT_FINITE)
        start = PrimalDual(found.u.clamp(*problem.bounds), found.multipliers)
        near = progress.is_open & found.near
        return self._polished(problem, progress, start, activation, near, found.solved)

    def _elastic(
        self,
        problem: Problem,
        progress: Progress,
        guess: Tensor,
        activation: Tensor,
        price: float,
        last: bool,
    ) -> Progress:
        """All constraints at a high price: a violation that stays cannot be helped."""
        scale = enter(problem, guess)[0].scale
        elastic = problem._replace(rows=_soft(problem.rows, price / scale[..., None, None]))
        found = self._followed(elastic, guess, progress.is_open, COARSE if last else FINE)
        progress = progress.counted(found.iterations)
        start = PrimalDual(found.u.clamp(*problem.bounds), found.multipliers)
        near = progress.is_open & found.near
        progress = self._polished(problem, progress, start, activation, near)
        if not last:
            return progress
        # what is less than the last phase resolves in this precision shows nothing
        told = max(self.tolerance, torch.finfo(guess.dtype).eps ** COARSE)
        stuck = progress.is_open & found.solved & (judge(problem, start.u).violation > told)
        return progress.finished(stuck, start, SolverStatus.INFEASIBLE)

    def _followed(
        self, problem: Problem, guess: Tensor, which: Tensor, accuracy: float = FINE
    ) -> Found:
        """The interior-point method for some of the problems, alone if they can be."""
        index = which.flatten().nonzero().squeeze(-1)
        if not problem.selectable or len(index) == which.numel():
            return follow(problem, guess, self.most, which, accuracy)
        part = follow(problem.select(index), guess[index], self.most, which[index], accuracy)
        count = torch.zeros(which.shape, dtype=torch.long, device=which.device)
        empty = torch.zeros_like(which)
        whole = Found(guess, torch.zeros_like(problem.rows.linear), empty, empty, empty, count)
        return whole.replaced(index, part)

    def _polished(
        self,
        problem: Problem,
        progress: Progress,
        start: PrimalDual,
        activation: Tensor,
        chosen: Bool[Tensor, "*b"],
        solved: Bool[Tensor, "*b"] | None = None,
    ) -> Progress:
        """Newton's method where a phase came near a solution; what it solves is finished.

        Unless it has to be exact, so is what was `solved` before where Newton's method fails: there
        so many constraints are nearly active that rounding decides which ones are. Of open
        problems the best of all points is kept.
        """
        progress = progress.offered(problem, start, self.tolerance)
        accuracy = problem.state.new_tensor(self.solver.tolerance)
        tolerance = problem.state.new_tensor(self.tolerance)
        polished = polish(problem, start, activation, chosen, accuracy, tolerance)
        progress = progress.counted(polished.steps)
        point, end = polished.point, SolverStatus.CONVERGED
        progress = progress.finished(polished.solved, point, end)
        if solved is not None and not self.exact:
            progress = progress.finished(progress.is_open & solved & polished.began, start, end)
        return progress.offered(problem, point, self.tolerance)


def _soft(rows: ConstraintRows, price: Float[Tensor, "*b 1 1"]) -> ConstraintRows:
    """Hard rows at a price, soft ones as they are."""
    hard = rows.linear.isinf() & rows.applies
    return rows._replace(linear=torch.where(hard, price.expand_as(rows.linear), rows.linear))


def activation_weight(
    problem: Problem, x: Float[Tensor, "*b T1 n"], u: Float[Tensor, "*b T m"]
) -> Float[Tensor, "*b 1 K"]:
    """κ of each constraint, in ν + κ g: as curved as the cost, at their largest over time.

    So neither the unit of the cost nor that of a constraint makes a difference.
    """
    acting = pad_controls(u)
    _, _, curvature = expand_cost(problem.cost, x, acting)
    each = curvature.xx.diagonal(dim1=-2, dim2=-1).abs().sum(-1)
    each = each + curvature.uu.diagonal(dim1=-2, dim2=-1).abs().sum(-1)
    bend = each.amax(-1)[..., None, None]
    of_x, of_u = linearise_rows(problem.rows, x, acting)
    steep = (of_x.square().sum(-1) + of_u.square().sum(-1)).amax(-2, keepdim=True)
    steep = torch.maximum(steep, NARROW * steep.amax(-1, keepdim=True))
    usable = (steep > 0) & (bend > 0) & steep.isfinite() & bend.isfinite()
    return torch.where(usable, bend / steep, torch.ones_like(steep))
