"""From tracks to calibrated parameters: track, see what is informed, fit, judge."""

import logging
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.identification.arrow import Arrow
from diffstack_mmv.identification.fit import Data, Fit, Method, Shooting
from diffstack_mmv.identification.linearisation import Tracker, normal_equations
from diffstack_mmv.identification.problem import Problem
from diffstack_mmv.identification.sensitivity import (
    Sensitivity,
    Thresholds,
    Verdict,
    sensitivity,
)
from diffstack_mmv.identification.tracking import LevenbergMarquardt, Tracked, track

logger = logging.getLogger(__name__)


class Identification(NamedTuple):
    """What an identification found."""

    before: Fit
    after: Fit
    active: Bool[Tensor, " p"]  # which entries of θ were fitted
    prior_sensitivity: Sensitivity
    sensitivity: Sensitivity
    verdicts: tuple[Verdict, ...]
    noise_factor: float  # deviation of the residuals over the assumed one


@dataclass(frozen=True)
class Identifier:
    """Identifies the parameters of a vehicle from tracks.

    Args:
        method: How θ is found once the controls are.
        tracking: Solver that infers controls for a known vehicle.
        thresholds: When a parameter counts as informed.
    """

    method: Method = field(default_factory=Shooting)
    tracking: LevenbergMarquardt = LevenbergMarquardt(60)
    thresholds: Thresholds = Thresholds()

    @torch.no_grad()
    def __call__(self, tracker: Tracker, data: Data) -> Identification:
        """Track with the prior, fit what the tracks inform, track again, and tell how sure it is.

        Args:
            tracker: Model, residuals and learned numbers.
            data: Tracks to fit and tracks to judge by.
        """
        theta = tracker.parameters.start()
        before = self.tracked(tracker, data, theta, None)
        logger.info("Tracked with the prior: cost %.3f", float(before.fitted.simulated.cost.sum()))
        prior, factor = information(tracker, data.fitted, before.theta, before.fitted)
        informed = prior.conditional_ratio <= self.thresholds.informed
        active, after, posterior = torch.zeros_like(informed), before, prior
        while not torch.equal(active, informed):
            # what the tracks turn out not to inform goes back to its prior; the rest is refitted
            active = informed
            after = self._fitted(tracker, data, before, active)
            posterior, factor = information(tracker, data.fitted, after.theta, after.fitted)
            informed = active & (posterior.conditional_ratio <= self.thresholds.informed)
        values = tracker.parameters.values(after.theta)
        verdicts = [
            verdict if fitted else Verdict.NOT_IDENTIFIABLE
            for verdict, fitted in zip(
                posterior.verdicts(values, self.thresholds), active.tolist(), strict=True
            )
        ]
        return Identification(before, after, active, prior, posterior, tuple(verdicts), factor)

    def _fitted(self, tracker: Tracker, data: Data, before: Fit, active: Bool[Tensor, " p"]) -> Fit:
        """Fit the active entries of θ, if any, and track again with the result."""
        if not bool(active.any()):
            return before
        found = self.method(tracker, data, before, active)
        return self.tracked(tracker, data, found.theta, found)

    def tracked(
        self, tracker: Tracker, data: Data, theta: Float[Tensor, " p"], start: Fit | None
    ) -> Fit:
        """Controls of all tracks at θ."""
        guess = data.fitted.guess if start is None else start.fitted.unknowns
        fitted = track(tracker, theta, data.fitted, guess, self.tracking)
        guess = data.heldout.guess if start is None else start.heldout.unknowns
        heldout = track(tracker, theta, data.heldout, guess, self.tracking)
        return Fit(theta, fitted, heldout, () if start is None else start.history)


class Informed(NamedTuple):
    """What tracks say, and how well the assumed noise fits them."""

    sensitivity: Sensitivity
    noise_factor: float


def information(
    tracker: Tracker, problem: Problem, theta: Float[Tensor, " p"], tracked: Tracked
) -> Informed:
    """What the tracks say about the parameters at θ; noise above the assumed one lessens it."""
    unknowns, simulated, _ = tracked
    jacobian = tracker.jacobian(theta, problem, unknowns, simulated)
    arrow = normal_equations(jacobian, simulated.residual, unknowns)
    factor = noise_factor(problem, tracked, arrow)
    return Informed(sensitivity(arrow, tracker.parameters, theta, max(factor, 1.0)), factor)


def noise_factor(problem: Problem, tracked: Tracked, arrow: Arrow) -> float:
    """Root mean square residual of the recorded numbers over the assumed standard deviation.

    Fitted unknowns take degrees of freedom as far as the tracks, not their priors, determine them:
    tr H⁻¹ (H - 1) of each track.
    """
    targets = problem.targets
    recorded = 2 * targets.weight.sum() + (targets.control_weight > 0).sum()
    inverse = torch.cholesky_inverse(torch.linalg.cholesky(arrow.own))
    taken = arrow.own.shape[-1] - inverse.diagonal(dim1=-2, dim2=-1).sum(-1)
    freedom = max(float(recorded - taken.sum()), 1.0)
    return math.sqrt(float(tracked.simulated.residual.square().sum()) / freedom)
