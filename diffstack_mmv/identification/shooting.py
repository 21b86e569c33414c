"""Controls and physical parameters fitted together by multiple shooting."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.identification.arrow import Box, solve
from diffstack_mmv.identification.fit import (
    Data,
    EarlyStopping,
    Fit,
    Watch,
    in_deviations,
    total_cost,
)
from diffstack_mmv.identification.linearisation import Tracker, normal_equations
from diffstack_mmv.identification.outlook import Linearised, Step, attempt, closing_share
from diffstack_mmv.identification.tracking import (
    FIRST_DAMPING,
    LEAST_DAMPING,
    MOST_DAMPING,
    LevenbergMarquardt,
    Tracked,
    damping_factor,
    follow,
    in_one_piece,
)

REACH = 1.0  # prior deviations that one step may move a value


class Task(NamedTuple):
    """What stays the same in a fit."""

    tracker: Tracker
    data: Data
    active: Bool[Tensor, " p"]  # which entries of θ are fitted


class Move(NamedTuple):
    """A fit after a step, and how far the step kept what it promised."""

    fit: Fit
    weights: Float[Tensor, "N m s"]  # of the gaps in the merit
    decrease: float  # of the merit
    promised: float


class Stand(NamedTuple):
    """How far a fit has come."""

    fit: Fit
    weights: Float[Tensor, "N m s"]
    damping: float
    moved: bool = True  # whether the last iteration lowered the merit
    ended: bool = False


@dataclass(frozen=True)
class Shooting:
    """Multiple shooting: controls, placements, nodes and θ at once, by Levenberg-Marquardt.

    Per step the nodes are eliminated by continuity and each track by its Schur complement. How
    tracks are cut is told by `TrackingSettings.segment_steps`.

    Args:
        max_iterations: Limit of iterations.
        tolerance: Promised relative decrease of the cost at which the fit has converged.
        stopping: When to stop early.
        heldout_iterations: Iterations per step for the controls of the held-out tracks.
        anew: Whether the fitted tracks begin at their nodes as recorded, which rarely ends in a
            poor optimum, rather than as tracked before. What ends above the cost before is fitted
            again from there.

    Raises:
        ValueError: A limit is below one, or the tolerance is not positive.
    """

    max_iterations: int = 40
    tolerance: float = 1e-6
    stopping: EarlyStopping = EarlyStopping()
    heldout_iterations: int = 1
    anew: bool = True

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)
        require_at_least("heldout_iterations", self.heldout_iterations, 1)
        require_positive("tolerance", self.tolerance)

    def __call__(
        self, tracker: Tracker, data: Data, before: Fit, active: Bool[Tensor, " p"]
    ) -> Fit:
        """Fit the active entries of θ, beginning at `before`."""
        task = Task(tracker, data, active)
        if not self.anew:
            return self._run(task, before, before)
        guess = data.fitted.guess
        simulated = tracker.simulate(before.theta, data.fitted, guess)
        recorded = Tracked(guess, simulated, before.fitted.converged)
        fit = self._run(task, before, before._replace(fitted=recorded))
        if total_cost(tracker, fit) <= total_cost(tracker, before):
            return fit
        return self._run(task, before, before)

    def _run(self, task: Task, before: Fit, begun: Fit) -> Fit:
        """Iterate from `begun`; `before` is what held-out tracks are compared with."""
        tracker, data, _ = task
        watch = Watch(self.stopping, before)
        watch.see(before, total_cost(tracker, before))
        now = Stand(begun, torch.zeros_like(begun.fitted.simulated.gap), FIRST_DAMPING)
        for _ in range(self.max_iterations):
            now = self._next(task, now)
            if now.moved:
                now = now._replace(fit=self._judged(tracker, data, now.fit))
                if not watch.see(now.fit, total_cost(tracker, now.fit)):
                    break
            if now.ended:
                break
        best = watch.best
        return best._replace(
            fitted=in_one_piece(tracker, best.theta, data.fitted, best.fitted),
            heldout=in_one_piece(tracker, best.theta, data.heldout, best.heldout),
            history=tuple(watch.history),
        )

    def _next(self, task: Task, now: Stand) -> Stand:
        """Linearise, and damp the step until it lowers the merit."""
        fit, weights, damping = now.fit, now.weights, now.damping
        unknowns, simulated, _ = fit.fitted
        jacobian = task.tracker.jacobian(fit.theta, task.data.fitted, unknowns, simulated)
        here = Linearised(unknowns, simulated, jacobian)
        least = self.tolerance * total_cost(task.tracker, fit)
        while damping <= MOST_DAMPING:
            move = _move(task, fit, here, weights, damping)
            weights, small = move.weights, move.promised < least
            ratio = torch.tensor(move.decrease / move.promised)
            damping = max(damping * float(damping_factor(ratio)), LEAST_DAMPING)
            if move.decrease > 0:
                return Stand(move.fit, weights, damping, ended=small)
            if small:
                break
        return Stand(fit, weights, damping, moved=False, ended=True)

    def _judged(self, tracker: Tracker, data: Data, fit: Fit) -> Fit:
        few = LevenbergMarquardt(self.heldout_iterations)
        heldout = follow(tracker, fit.theta, data.heldout, fit.heldout.unknowns, few)
        return fit._replace(heldout=heldout)


def _move(
    task: Task, fit: Fit, here: Linearised, weights: Float[Tensor, "N m s"], damping: float
) -> Move:
    """Solve the damped equations, take the step and judge it."""
    tracker, data, active = task
    unknowns, simulated, jacobian = here
    parameters = tracker.parameters
    share = simulated.cost.new_tensor([damping])
    closing = closing_share(share)
    plain = normal_equations(jacobian, simulated.residual, unknowns, closing)
    arrow = in_deviations(plain, tracker, fit.theta).restricted(active)
    room = parameters.room(fit.theta)
    box = Box(room.lower[active].clamp_min(-REACH), room.upper[active].clamp_max(REACH))
    own, shared = solve(arrow.damped(share.expand(len(unknowns.rates)), share), box)
    deviations = torch.zeros_like(fit.theta)
    deviations[active] = shared
    change = parameters.prior.std * deviations
    values = parameters.values(fit.theta) + change
    theta = torch.where(active, parameters.theta_for(values), fit.theta)
    step = Step(own, change / parameters.slope(fit.theta), closing)
    trial = attempt(tracker, theta, data.fitted, here, step, weights)
    prior = parameters.penalty(fit.theta)
    promised = prior.square() - (prior + deviations).square()
    decrease = prior.square() - parameters.penalty(theta).square()
    fitted = fit.fitted._replace(unknowns=trial.unknowns, simulated=trial.simulated)
    return Move(
        fit._replace(theta=theta, fitted=fitted),
        trial.weights,
        float(trial.decrease.sum() + 0.5 * decrease.sum()),
        float(trial.promised.sum() + 0.5 * promised.sum()),
    )
