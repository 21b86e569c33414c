"""The phases of a solve, each for the problems that the one before has left."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.constraint import ConstraintRows
from diffstack_mmv.control.constrained.interior import COARSE, FINE, Found, enter, follow
from diffstack_mmv.control.constrained.local import Problem, linearise_rows
from diffstack_mmv.control.constrained.newton import PrimalDual, polish
from diffstack_mmv.control.expansion import expand_cost, pad_controls
from diffstack_mmv.control.ilqr import ILQR
from diffstack_mmv.control.iteration import OPEN
from diffstack_mmv.types import SolverStatus

PRICES = 1e3, 1e6  # of a violation in the elastic problem, the gradient of the cost being scaled
NARROW = (
    1e-2  # gradient of a constraint relative to the steepest one, below which it counts as that
)


class Progress(NamedTuple):
    """Where each problem stands."""

    u: Float[Tensor, "*b T m"]
    multipliers: Float[Tensor, "*b T1 K"]
    status: Int[Tensor, "*b"]
    iterations: Int[Tensor, "*b"]

    @property
    def is_open(self) -> Bool[Tensor, "*b"]:
        """Which problems are still being solved."""
        return self.status == OPEN

    def where(
        self, mask: Bool[Tensor, "*b"], point: PrimalDual, status: SolverStatus
    ) -> "Progress":
        """With the problems of the mask finished at a point."""
        wide = mask[..., None, None]
        return self._replace(
            u=torch.where(wide, point.u, self.u),
            multipliers=torch.where(wide, point.multipliers, self.multipliers),
            status=torch.where(mask, int(status), self.status),
        )

    def counted(self, iterations: Int[Tensor, "*b"]) -> "Progress":
        """With the iterations of a phase added to the open problems."""
        return self._replace(iterations=self.iterations + iterations * self.is_open)


def begin(u: Float[Tensor, "*b T m"], guess: Float[Tensor, "*b T1 K"]) -> Progress:
    """Progress at a guess of controls and multipliers."""
    count = torch.zeros(u.shape[:-2], dtype=torch.long, device=u.device)
    return Progress(u, guess, count + OPEN, count)


@dataclass(frozen=True)
class Phases:
    """The settings, see `ConstrainedILQR`."""

    solver: ILQR
    most: int
    tolerance: float

    def run(self, problem: Problem, guess: Tensor, start: PrimalDual | None) -> Progress:
        """Solve every problem or find out why not.

        Args:
            problem: The problems, without graph.
            guess: Of the controls, of shape (*b, T, m).
            start: What may be near a solution, which Newton's method tries first.
        """
        progress = begin(guess, torch.zeros_like(problem.rows.linear))
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
        limit = torch.where(progress.is_open, SolverStatus.ITERATION_LIMIT, progress.status)
        return progress._replace(status=limit)

    def _unconstrained(self, problem: Problem, progress: Progress, guess: Tensor) -> Progress:
        """Finished is where a solution without constraints touches none of them.

        So is a problem that runs off to infinity without touching any.
        """
        dynamics, cost, rows, bounds, state = problem
        plain = self.solver(dynamics, cost, bounds, state, guess)
        values = rows.values(plain.states, pad_controls(plain.controls))
        clear = torch.where(rows.signed, values == 0, values < 0) | ~rows.applies
        free = progress.is_open & clear.flatten(-2).all(-1)
        progress = progress.counted(plain.iterations)
        point = PrimalDual(plain.controls, torch.zeros_like(values))
        for end in (SolverStatus.CONVERGED, SolverStatus.UNBOUNDED):
            progress = progress.where(free & (plain.status == end), point, end)
        return progress

    def _interior(
        self, problem: Problem, progress: Progress, guess: Tensor, activation: Tensor
    ) -> Progress:
        found = self._followed(problem, guess, progress.is_open)
        progress = progress.counted(found.iterations)
        lost = progress.is_open & ~found.started
        at_guess = PrimalDual(guess, torch.zeros_like(progress.multipliers))
        progress = progress.where(lost, at_guess, SolverStatus.NOT_FINITE)
        start = PrimalDual(found.u, found.multipliers)
        return self._polished(problem, progress, start, activation, progress.is_open & found.near)

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
        start = PrimalDual(found.u, found.multipliers)
        chosen = progress.is_open & found.solved
        near = progress.is_open & found.near
        progress = self._polished(problem, progress, start, activation, near)
        if not last:
            return progress
        u = found.u.clamp(*problem.bounds)
        values = problem.rows.values(problem.rollout(u), pad_controls(u))
        # what is less than the last phase resolves in this precision shows nothing
        told = max(self.tolerance, torch.finfo(u.dtype).eps ** COARSE)
        stuck = chosen & progress.is_open & (problem.rows.violation(values) > told)
        return progress.where(stuck, PrimalDual(u, found.multipliers), SolverStatus.INFEASIBLE)

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
    ) -> Progress:
        """Newton's method where a phase came near a solution; what it solves is finished."""
        start = start._replace(u=start.u.clamp(*problem.bounds))
        accuracy = problem.state.new_tensor(self.solver.tolerance)
        tolerance = problem.state.new_tensor(self.tolerance)
        polished = polish(problem, start, activation, chosen, accuracy, tolerance)
        progress = progress.counted(polished.steps)
        return progress.where(polished.solved, polished.point, SolverStatus.CONVERGED)


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
