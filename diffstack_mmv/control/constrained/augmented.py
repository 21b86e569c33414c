"""Constraints as part of the cost: an augmented Lagrangian around a solver without constraints.

Multipliers and penalty are numbers of that cost, so that a compiled solver has one library for all
rounds of all problems of a kind. It is fast where it converges, which it does not everywhere: with
states that follow from the controls it may stay between two obstacles.

Source: Birgin and Martínez, Practical Augmented Lagrangian Methods for Constrained Optimization,
SIAM 2014, Algorithm 4.1; Howell et al., ALTRO, IROS 2019, for trajectories.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.priced import priced_cost, yielding
from diffstack_mmv.control.constrained.solution import ConstrainedSolution
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.ilqr import ILQR
from diffstack_mmv.types import Solution, SolverStatus

FIRST = 0.03  # penalty of a violation of one, relative to the cost of standing still at x_0
SMALLEST_COST, LARGEST_COST = 1e-3, 1e3  # that the penalty goes by
GROWTH = 5.0
PROGRESS = 0.25  # of the error from one round to the next, above which the penalty grows
ROUNDS = 12
STEPS = 30  # of a round
STUCK, DEAR = 0.9, 100.0
"""Share of the error before above which a violation stays, once the penalty has grown so much."""
HOPELESS = 1e8  # growth of the penalty, beyond which rounds are lost in rounding


class Place(NamedTuple):
    """Where each problem begins a round."""

    u: Float[Tensor, "B T m"]
    multipliers: Float[Tensor, "B T1 K"]
    penalty: Float[Tensor, " B"]
    error: Float[Tensor, " B"]  # of the round before

    def select(self, index: Int[Tensor, " k"]) -> "Place":
        """Some of the problems."""
        return Place(*(part[index] for part in self))


class Approach(NamedTuple):
    """Where the method ended; a problem that is not solved stands as its last round left it."""

    plain: Solution  # its cost is that of the round, with multipliers and penalty in it
    multipliers: Float[Tensor, "B T1 K"]
    values: Float[Tensor, "B T1 K"]
    error: Float[Tensor, " B"]  # violation and complementarity, |max(g - s, -ν / ρ)|
    solved: Bool[Tensor, " B"]
    stuck: Bool[Tensor, " B"]  # at a violation that no price lowers

    @property
    def lost(self) -> Bool[Tensor, " B"]:
        """Which problems another round does not help."""
        lost = (SolverStatus.NOT_FINITE, SolverStatus.UNBOUNDED)
        return torch.isin(self.plain.status, self.plain.status.new_tensor(lost))

    def replaced(self, index: Int[Tensor, " k"], part: "Approach") -> "Approach":
        """With another round of the problems `index`."""
        iterations = self.plain.iterations.index_add(0, index, part.plain.iterations)

        def merged(old: Tensor, new: Tensor) -> Tensor:
            return old.index_copy(0, index, new)

        plain = Solution(*map(merged, self.plain, part.plain))._replace(iterations=iterations)
        return Approach(plain, *map(merged, self[1:], part[1:]))

    def solution(self, problem: Problem) -> ConstrainedSolution:
        """The result; a problem that is not solved counts as the rounds have left it."""
        rows, plain = problem.rows, self.plain
        multipliers = self.multipliers.nan_to_num(0.0).split(list(rows.widths), -1)
        left = torch.where(self.stuck, SolverStatus.INFEASIBLE, SolverStatus.ITERATION_LIMIT)
        status = torch.where(self.solved | self.lost, plain.status, left)
        # that of the round pays for the slack of its multipliers, which an open problem exceeds
        total = problem.cost(plain.states, pad_controls(plain.controls)).sum(-1)
        total = total + rows.paid(rows.excess(self.values))
        finite = plain.cost.isfinite()  # elsewhere the states told are no longer those found
        plain = plain._replace(cost=torch.where(finite, total, plain.cost), status=status)
        violation = torch.where(finite, rows.violation(self.values), torch.inf)
        return ConstrainedSolution(*plain, violation, multipliers)


@dataclass(frozen=True)
class AugmentedLagrangian:
    """Rounds of a solver without constraints, multipliers and penalties updated between them.

    Args:
        solver: Of the rounds.
        tolerance: Violation and complementarity of a solved problem, in units of the constraints.
    """

    solver: ILQR
    tolerance: float

    def __call__(
        self,
        problem: Problem,
        u: Float[Tensor, "B T m"],
        multipliers: Float[Tensor, "B T1 K"],
    ) -> Approach:
        """Solve problems with one leading dimension that can be selected.

        Args:
            problem: The problems, without graph.
            u: Guess of the controls.
            multipliers: Guess of the multipliers.
        """
        first = _first_penalty(problem, u)
        # a round that takes many steps is one of little use: the next one begins where it ends
        solver = replace(self.solver, max_iterations=min(self.solver.max_iterations, STEPS))
        place = Place(u, multipliers, first, torch.full_like(first, torch.inf))
        index = torch.arange(len(u), device=u.device)
        found = _round(solver, problem, place, first, self.tolerance)
        whole = found
        for _ in range(1, ROUNDS):
            error = found.error
            slow = error > PROGRESS * place.error
            penalty = torch.where(slow, GROWTH * place.penalty, place.penalty)
            going = ~found.solved & ~found.stuck & error.isfinite() & (penalty < HOPELESS * first)
            keep = going.nonzero().squeeze(-1)
            if len(keep) == 0:
                break
            place = Place(found.plain.controls, found.multipliers, penalty, error).select(keep)
            problem, index, first = problem.select(keep), index[keep], first[keep]
            found = _round(solver, problem, place, first, self.tolerance)
            whole = whole.replaced(index, found)
        return whole


def _round(
    solver: ILQR, problem: Problem, place: Place, first: Tensor, tolerance: float
) -> Approach:
    """One solution; a problem is solved where it changes no multiplier any more."""
    rows, penalty, before = problem.rows, place.penalty[:, None, None], place.multipliers
    cost = priced_cost(problem, before, penalty)
    plain = solver(problem.dynamics, cost, problem.bounds, problem.state, place.u)
    values = rows.values(plain.states, pad_controls(plain.controls))
    multipliers = yielding(before + penalty * values, penalty, rows).multipliers
    change = (multipliers - before).abs().amax((-2, -1)) / place.penalty
    violation = rows.violation(values)
    error = torch.maximum(change, violation)
    stays = (violation > STUCK * place.error) & (violation > tolerance)
    solved = plain.converged & (error <= tolerance)
    return Approach(
        plain, multipliers, values, error, solved, stays & (place.penalty > DEAR * first)
    )


def _first_penalty(problem: Problem, u: Tensor) -> Float[Tensor, " B"]:
    """By the cost of standing at the initial state, which takes no roll-out."""
    acting = pad_controls(u)
    standing = problem.state.unsqueeze(-2).expand(*acting.shape[:-1], -1)
    size = problem.cost(standing, acting).abs().sum(-1)
    return FIRST * size.clamp(SMALLEST_COST, LARGEST_COST)
