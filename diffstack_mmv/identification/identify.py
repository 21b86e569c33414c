"""From tracks to calibrated parameters: track, see what is informed, fit, look around, judge."""

import logging
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.identification.fit import (
    Data,
    Fit,
    Method,
    moved_to,
    total_cost,
    worse,
)
from diffstack_mmv.identification.linearisation import Tracker
from diffstack_mmv.identification.optima import Optimum, alike, optimum, scattered, shares, together
from diffstack_mmv.identification.sensitivity import Sensitivity, Thresholds, Verdict
from diffstack_mmv.identification.shooting import Shooting
from diffstack_mmv.identification.tracking import LevenbergMarquardt, track

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
    optima: tuple[Optimum, ...]  # the estimate, then others that explain the tracks


@dataclass(frozen=True)
class Identifier:
    """Identifies the parameters of a vehicle from tracks.

    Args:
        method: How θ is found once the controls are.
        tracking: Solver that infers controls for a known vehicle.
        thresholds: When a parameter counts as informed.
        starts: How many other starts, spread over the prior, look for other optima.
        search: Fits from them.

    Raises:
        ValueError: The number of starts is negative.
    """

    method: Method = field(default_factory=Shooting)
    tracking: LevenbergMarquardt = LevenbergMarquardt(60)
    thresholds: Thresholds = Thresholds()
    starts: int = 8
    search: Method = field(default_factory=Shooting)

    def __post_init__(self) -> None:
        require_at_least("starts", self.starts, 0)

    @torch.no_grad()
    def __call__(self, tracker: Tracker, data: Data) -> Identification:
        """Track with the prior, fit what the tracks inform, and tell how sure it is.

        What a fit says is what its optimum says; others that explain the tracks as well widen it.

        Args:
            tracker: Model, residuals and learned numbers.
            data: Tracks to fit and tracks to judge by.
        """
        theta = tracker.parameters.start()
        before = self.tracked(tracker, data, theta, None)
        logger.info("Tracked with the prior: cost %.3f", float(before.fitted.simulated.cost.sum()))
        prior = optimum(tracker, data.fitted, before).sensitivity
        informed = prior.conditional_ratio <= self.thresholds.informed
        active = torch.zeros_like(informed)
        best = optimum(tracker, data.fitted, before, active)
        while not torch.equal(active, informed):
            # what the tracks turn out not to inform goes back to its prior; the rest is refitted
            active = informed
            fit = self._fitted(self.method, tracker, data, before, active)
            best = optimum(tracker, data.fitted, fit, active)
            ratio = best.sensitivity.conditional_ratio
            informed = active & (ratio <= self.thresholds.informed)
        optima = self._optima(tracker, data, best, active)
        after, posterior = optima[0].fit, together(optima, tracker.parameters)
        values = tracker.parameters.values(after.theta)
        verdicts = tuple(
            verdict if fitted else Verdict.NOT_IDENTIFIABLE
            for verdict, fitted in zip(
                posterior.verdicts(values, self.thresholds), active.tolist(), strict=True
            )
        )
        factor = optima[0].noise_factor
        return Identification(before, after, active, prior, posterior, verdicts, factor, optima)

    def _optima(
        self, tracker: Tracker, data: Data, first: Optimum, active: Bool[Tensor, " p"]
    ) -> tuple[Optimum, ...]:
        """All optima that are found, that of the largest mass first."""
        found = [first]
        if not bool(active.any()):
            return (first,)
        for theta in scattered(tracker.parameters, self.starts):
            start = torch.where(active, theta, first.fit.theta)
            begun = self._begun(tracker, data, first.fit, start)
            fit = self._fitted(self.search, tracker, data, begun, active)
            other = optimum(tracker, data.fitted, fit, active)
            known = any(alike(each, other, tracker.parameters) for each in found)
            if not known and not worse(fit, first.fit):
                found.append(other)
                logger.info("Another optimum: cost %.3f", total_cost(tracker, fit))
        best = found[int(shares(found).argmax())]
        if best is first:
            return tuple(found)
        fit = self._fitted(self.method, tracker, data, best.fit, active)
        others = [each for each in found if each is not best]
        return (optimum(tracker, data.fitted, fit, active), *others)

    def _begun(self, tracker: Tracker, data: Data, fit: Fit, theta: Float[Tensor, " p"]) -> Fit:
        """A fit that begins at another θ."""
        moved = moved_to(tracker, data, fit, theta)
        heldout = track(tracker, theta, data.heldout, fit.heldout.unknowns, self.tracking)
        return moved._replace(heldout=heldout)

    def _fitted(
        self,
        method: Method,
        tracker: Tracker,
        data: Data,
        before: Fit,
        active: Bool[Tensor, " p"],
    ) -> Fit:
        """Fit the active entries of θ, if any, and track again with the result."""
        if not bool(active.any()):
            return before
        found = method(tracker, data, before, active)
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
