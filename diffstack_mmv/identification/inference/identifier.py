"""From tracks to calibrated parameters: track, find what is informed, fit, search other optima."""

import logging
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.identification.inference.optima import (
    LocalOptimum,
    analyse_optimum,
    combined_sensitivity,
    is_same_optimum,
    relevant_optima,
)
from diffstack_mmv.identification.inference.sensitivity import (
    Identifiability,
    IdentifiabilityThresholds,
    Sensitivity,
)
from diffstack_mmv.identification.inference.starts import calm_starts
from diffstack_mmv.identification.shooting.fit import (
    EstimationData,
    FitMethod,
    ParameterFit,
    significantly_worse,
    total_cost,
    with_parameters,
)
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.multiple_shooting import MultipleShooting
from diffstack_mmv.identification.shooting.tracking import LevenbergMarquardt, infer_controls
from dmmv_conventions.progress import counted, waiting

logger = logging.getLogger(__name__)

HOPELESS = 10.0  # times the cost of the first fit: a start that stays above it is given up


class Identification(NamedTuple):
    """Result of an identification."""

    before: ParameterFit
    after: ParameterFit
    active: Bool[Tensor, " p"]  # which entries of θ were fitted
    sensitivity: Sensitivity
    identifiability: tuple[Identifiability, ...]
    noise_factor: float  # deviation of the residuals over the assumed one
    optima: tuple[LocalOptimum, ...]  # the estimate, then others that explain the tracks


@dataclass(frozen=True)
class Identifier:
    """Identifies the parameters of a vehicle from tracks.

    Args:
        method: Algorithm that fits θ.
        tracking: Solver that infers controls for a known vehicle.
        thresholds: When a parameter counts as informed.
        starts: Number of further starts, spread over the prior, that search for other optima.
        search: Algorithm that fits θ from them.

    Raises:
        ValueError: The number of starts is negative.
    """

    method: FitMethod = field(default_factory=MultipleShooting)
    tracking: LevenbergMarquardt = LevenbergMarquardt(60)
    thresholds: IdentifiabilityThresholds = IdentifiabilityThresholds()
    starts: int = 8
    search: MultipleShooting = field(default_factory=MultipleShooting)

    def __post_init__(self) -> None:
        require_at_least("starts", self.starts, 0)

    @torch.no_grad()
    def __call__(self, simulator: TrackSimulator, data: EstimationData) -> Identification:
        """Track with the prior, fit what the tracks inform, and compute its uncertainty.

        The uncertainty is that of the optimum, widened by others that explain the tracks as well.

        Args:
            simulator: Model, residuals and learned parameters.
            data: Tracks to fit and tracks to judge by.
        """
        theta = simulator.parameters.start()
        with waiting("track with the prior"):
            before = self._tracked(simulator, data, theta, None)
        cost = float(before.fitted.simulated.cost.sum())
        name = type(simulator.vehicle.model).__name__
        logger.info("%s tracks with its priors: cost %.3f", name, cost)
        prior = analyse_optimum(simulator, data.fitted, before).sensitivity
        informed = prior.conditional_ratio <= self.thresholds.informed
        active = torch.zeros_like(informed)
        best = analyse_optimum(simulator, data.fitted, before, active)
        while not torch.equal(active, informed):
            # what the tracks do not inform returns to its prior; the rest is fitted again
            active = informed
            fit = self._fitted(self.method, simulator, data, before, active)
            best = analyse_optimum(simulator, data.fitted, fit, active)
            ratio = best.sensitivity.conditional_ratio
            informed = active & (ratio <= self.thresholds.informed)
        optima = self._optima(simulator, data, best, active)
        after, posterior = optima[0].fit, combined_sensitivity(optima, simulator.parameters)
        values = simulator.parameters.values(after.theta)
        identifiability = tuple(
            verdict if fitted else Identifiability.NOT_IDENTIFIABLE
            for verdict, fitted in zip(
                posterior.classify(values, self.thresholds), active.tolist(), strict=True
            )
        )
        factor = optima[0].noise_factor
        return Identification(before, after, active, posterior, identifiability, factor, optima)

    def _optima(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        first: LocalOptimum,
        active: Bool[Tensor, " p"],
    ) -> tuple[LocalOptimum, ...]:
        """All optima that are found, that of the largest posterior mass first."""
        found = [first]
        if not bool(active.any()):
            return (first,)
        starts = calm_starts(simulator, data.fitted, first.fit.theta, active, self.starts)
        for start in counted(starts, "search other optima", "start"):
            other = self._searched(simulator, data, first, start, active)
            if other is None:
                continue
            known = any(is_same_optimum(each, other, simulator.parameters) for each in found)
            if not known and not significantly_worse(other.fit, first.fit):
                found.append(other)
                logger.info("Another optimum: cost %.3f", other.cost)
        best, *others = relevant_optima(found)
        if best is not first:
            fit = self._fitted(self.method, simulator, data, best.fit, active)
            again = analyse_optimum(simulator, data.fitted, fit, active)
            # tracks that begin as recorded may end at another optimum, which is known already
            best = again if is_same_optimum(best, again, simulator.parameters) else best
        return (best, *others)

    def _searched(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        first: LocalOptimum,
        start: Float[Tensor, " p"],
        active: Bool[Tensor, " p"],
    ) -> LocalOptimum | None:
        """The optimum that a start ends at; None where it does not come near the first one."""
        bound = HOPELESS * (first.cost + 1)
        before = self._from(simulator, data, first.fit, start)
        found = self.search.searching(bound)(simulator, data, before, active)
        if not total_cost(simulator, found) <= bound:
            logger.info("A start was given up")
            return None
        fit = self._tracked(simulator, data, found.theta, found)
        return analyse_optimum(simulator, data.fitted, fit, active)

    def _from(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        fit: ParameterFit,
        theta: Float[Tensor, " p"],
    ) -> ParameterFit:
        """A fit that starts at another θ."""
        start = with_parameters(simulator, data, fit, theta)
        heldout = infer_controls(
            simulator, theta, data.heldout, fit.heldout.unknowns, self.tracking
        )
        return start._replace(heldout=heldout)

    def _fitted(
        self,
        method: FitMethod,
        simulator: TrackSimulator,
        data: EstimationData,
        before: ParameterFit,
        active: Bool[Tensor, " p"],
    ) -> ParameterFit:
        """Fit the active entries of θ, if any, and track again with the result."""
        if not bool(active.any()):
            return before
        found = method(simulator, data, before, active)
        return self._tracked(simulator, data, found.theta, found)

    def _tracked(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        theta: Float[Tensor, " p"],
        start: ParameterFit | None,
    ) -> ParameterFit:
        """Controls of all tracks at θ."""
        guess = data.fitted.guess if start is None else start.fitted.unknowns
        fitted = infer_controls(simulator, theta, data.fitted, guess, self.tracking)
        guess = data.heldout.guess if start is None else start.heldout.unknowns
        heldout = infer_controls(simulator, theta, data.heldout, guess, self.tracking)
        return ParameterFit(theta, fitted, heldout, () if start is None else start.history)
