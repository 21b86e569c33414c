"""Controls and physical parameters fitted together, with early stopping on held-out tracks."""

import logging
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.identification.arrow import Arrow, Box, solve
from diffstack_mmv.identification.linearisation import Tracker, normal_equations
from diffstack_mmv.identification.outlook import (
    Linearised,
    Step,
    attempt,
    closing_share,
)
from diffstack_mmv.identification.problem import Problem
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

logger = logging.getLogger(__name__)

SIGNIFICANCE = 2.0  # standard deviations of a difference that is not chance
REACH = 1.0  # prior deviations that one step may move a value


class Progress(NamedTuple):
    """One iteration of a fit."""

    iteration: int
    cost: float  # of the fitted tracks and the prior
    heldout_cost: float  # of the held-out tracks


class Fit(NamedTuple):
    """A fit of physical parameters."""

    theta: Float[Tensor, " p"]
    fitted: Tracked
    heldout: Tracked
    history: tuple[Progress, ...]


class Data(NamedTuple):
    """Tracks to fit, and tracks to judge the fit by."""

    fitted: Problem
    heldout: Problem


class Method(Protocol):
    """How θ is found."""

    def __call__(
        self,
        tracker: Tracker,
        data: Data,
        before: Fit,
        active: Bool[Tensor, " p"],
    ) -> Fit:
        """Fit the active entries of θ, beginning at `before`."""
        ...


@dataclass(frozen=True)
class EarlyStopping:
    """Ends a fit when it explains held-out tracks worse, beyond what chance does.

    Args:
        patience: Iterations that may be worse before the fit ends.
        significance: Of an increase of the cost, in standard deviations.

    Raises:
        ValueError: The patience is below one, or the significance is not positive.
    """

    patience: int = 4
    significance: float = SIGNIFICANCE

    def __post_init__(self) -> None:
        require_at_least("patience", self.patience, 1)
        require_positive("significance", self.significance)


@dataclass
class Watch:
    """The iterate to return: the latest that is not worse on held-out tracks than any before."""

    stopping: EarlyStopping
    best: Fit
    reference: Fit | None = None  # the one that explains held-out tracks best
    history: list[Progress] = field(default_factory=list)
    waited: int = 0

    def see(self, fit: Fit, cost: float) -> bool:
        """Take note of an iterate; tell whether to go on."""
        reference = self.reference or fit
        heldout = heldout_cost(fit)
        self.history.append(Progress(len(self.history), cost, heldout))
        logger.info(
            "Iteration %d: cost %.3f, held-out tracks %.3f", len(self.history) - 1, cost, heldout
        )
        if worse(fit, reference, self.stopping.significance):
            self.waited += 1
        else:
            self.waited, self.best = 0, fit
        self.reference = fit if heldout <= heldout_cost(reference) else reference
        return self.waited < self.stopping.patience


def worse(fit: Fit, reference: Fit, significance: float = SIGNIFICANCE) -> bool:
    """Whether a fit explains held-out tracks worse than another, beyond what chance does.

    With d_i the increase of the cost of track i, it is worse if Σ d_i exceeds `significance` times
    (Σ d_i²)^½: a few tracks that speak against each other decide nothing.
    """
    increase = fit.heldout.simulated.cost - reference.heldout.simulated.cost
    return float(increase.sum()) > significance * float(increase.norm())


def heldout_cost(fit: Fit) -> float:
    """Tracking cost of the held-out tracks."""
    return float(fit.heldout.simulated.cost.sum())


def in_deviations(arrow: Arrow, tracker: Tracker, theta: Float[Tensor, " p"]) -> Arrow:
    """The equations for the values in prior standard deviations, with the priors added.

    In these units the priors are exactly quadratic, and a saturated soft clamp bends nothing.
    """
    parameters = tracker.parameters
    scaled = arrow.scaled(parameters.prior.std / parameters.slope(theta))
    return scaled._replace(
        shared=scaled.shared + torch.eye(len(theta), dtype=theta.dtype),
        shared_gradient=scaled.shared_gradient + parameters.penalty(theta),
    )


class Move(NamedTuple):
    """A fit after a step, and how far the step kept what it promised."""

    fit: Fit
    weights: Float[Tensor, "N m s"]
    decrease: float  # of the merit
    promised: float


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
        anew: Whether the fitted tracks begin at their nodes as recorded, not as tracked before.

    Raises:
        ValueError: The limit is below one.
    """

    max_iterations: int = 40
    tolerance: float = 1e-6
    stopping: EarlyStopping = EarlyStopping()
    heldout_iterations: int = 1
    anew: bool = True

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)

    def __call__(
        self, tracker: Tracker, data: Data, before: Fit, active: Bool[Tensor, " p"]
    ) -> Fit:
        """Fit the active entries of θ, beginning at `before`."""
        watch = Watch(self.stopping, before)
        now = before
        watch.see(now, total_cost(tracker, now))
        if self.anew:
            guess = data.fitted.guess
            simulated = tracker.simulate(now.theta, data.fitted, guess)
            now = now._replace(fitted=Tracked(guess, simulated, now.fitted.converged))
        damping, weights = FIRST_DAMPING, torch.zeros_like(now.fitted.simulated.gap)
        for _ in range(self.max_iterations):
            unknowns, simulated, _ = now.fitted
            jacobian = tracker.jacobian(now.theta, data.fitted, unknowns, simulated)
            here = Linearised(unknowns, simulated, jacobian)
            while True:
                move = self._move(tracker, data, now, active, here, weights, damping)
                weights = move.weights
                ratio = torch.tensor(move.decrease / move.promised)
                damping = max(damping * float(damping_factor(ratio)), LEAST_DAMPING)
                small = move.promised < self.tolerance * total_cost(tracker, now)
                ended = small or damping > MOST_DAMPING
                if move.decrease > 0 or ended:
                    break
            if move.decrease > 0:
                now = self._judged(tracker, data, move.fit)
                if not watch.see(now, total_cost(tracker, now)):
                    break
            if ended:
                break
        best = watch.best
        fitted = in_one_piece(tracker, best.theta, data.fitted, best.fitted)
        heldout = in_one_piece(tracker, best.theta, data.heldout, best.heldout)
        return best._replace(fitted=fitted, heldout=heldout, history=tuple(watch.history))

    def _move(
        self,
        tracker: Tracker,
        data: Data,
        now: Fit,
        active: Bool[Tensor, " p"],
        here: Linearised,
        weights: Float[Tensor, "N m s"],
        damping: float,
    ) -> Move:
        unknowns, simulated, jacobian = here
        parameters = tracker.parameters
        share = simulated.cost.new_tensor([damping])
        closing = closing_share(share)
        plain = normal_equations(jacobian, simulated.residual, unknowns, closing)
        arrow = in_deviations(plain, tracker, now.theta).restricted(active)
        room = parameters.room(now.theta)
        box = Box(room.lower[active].clamp_min(-REACH), room.upper[active].clamp_max(REACH))
        found = solve(arrow.damped(share.expand(len(unknowns.rates)), share), box)
        deviations = torch.zeros_like(now.theta)
        deviations[active] = found.shared
        change = parameters.prior.std * deviations
        step = Step(found.own, change / parameters.slope(now.theta), closing)
        theta = parameters.theta_for(parameters.values(now.theta) + change)
        theta = torch.where(active, theta, now.theta)
        trial = attempt(tracker, theta, data.fitted, here, step, weights)
        prior = parameters.penalty(now.theta)
        penalty = 0.5 * prior.square().sum()
        foreseen = penalty - 0.5 * (prior + deviations).square().sum()
        came = penalty - 0.5 * parameters.penalty(theta).square().sum()
        fitted = now.fitted._replace(unknowns=trial.unknowns, simulated=trial.simulated)
        return Move(
            now._replace(theta=theta, fitted=fitted),
            trial.weights,
            float(trial.decrease.sum() + came),
            float(trial.promised.sum() + foreseen),
        )

    def _judged(self, tracker: Tracker, data: Data, fit: Fit) -> Fit:
        few = LevenbergMarquardt(self.heldout_iterations)
        heldout = follow(tracker, fit.theta, data.heldout, fit.heldout.unknowns, few)
        return fit._replace(heldout=heldout)


def moved_to(tracker: Tracker, data: Data, fit: Fit, theta: Float[Tensor, " p"]) -> Fit:
    """The fit with another θ, unknowns of the fitted tracks as they were."""
    unknowns = fit.fitted.unknowns
    simulated = tracker.simulate(theta, data.fitted, unknowns)
    return fit._replace(theta=theta, fitted=fit.fitted._replace(simulated=simulated))


def total_cost(tracker: Tracker, fit: Fit) -> float:
    """Cost of the fitted tracks and of the prior; infinite if it is none."""
    penalty = 0.5 * tracker.parameters.penalty(fit.theta).square().sum()
    cost = float(fit.fitted.simulated.cost.sum() + penalty)
    return cost if cost == cost else float("inf")
