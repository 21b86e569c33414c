"""Records of a fit of physical parameters, and early stopping on held-out tracks."""

import logging
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.identification.shooting.block_arrowhead import BlockArrowhead
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.problem import TrackingProblem
from diffstack_mmv.identification.shooting.tracking import TrackingSolution

logger = logging.getLogger(__name__)

SIGNIFICANCE = 2.0  # standard deviations of a difference that counts as significant


class FitProgress(NamedTuple):
    """One iteration of a fit."""

    iteration: int
    cost: float  # of the fitted tracks and the prior
    heldout_cost: float  # of the held-out tracks


class ParameterFit(NamedTuple):
    """A fit of physical parameters."""

    theta: Float[Tensor, " p"]
    fitted: TrackingSolution
    heldout: TrackingSolution
    history: tuple[FitProgress, ...]


class EstimationData(NamedTuple):
    """Tracks to fit, and tracks to judge the fit by."""

    fitted: TrackingProblem
    heldout: TrackingProblem


@runtime_checkable
class FitMethod(Protocol):
    """An algorithm that fits θ."""

    def __call__(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        before: ParameterFit,
        active: Bool[Tensor, " p"],
    ) -> ParameterFit:
        """Fit the active entries of θ, beginning at `before`."""
        ...

    def unstopped(self) -> "FitMethod":
        """The same algorithm, which no held-out track ends."""
        ...


@dataclass(frozen=True)
class HeldoutStopping:
    """Ends a fit when it explains held-out tracks significantly worse, and its own not.

    Multiple shooting begins with open gaps, and the values may go far astray until they close. So
    iterations above the cost of the start do not count.

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


NO_STOPPING = HeldoutStopping(significance=1e9)
"""Lets a fit run to its end."""


@dataclass
class HeldoutMonitor:
    """The iterate to return: the latest that is not worse on held-out tracks than any before."""

    stopping: HeldoutStopping
    best: ParameterFit
    reference: ParameterFit | None = None  # the one that explains held-out tracks best
    history: list[FitProgress] = field(default_factory=list)
    waited: int = 0

    def observe(self, fit: ParameterFit, cost: float) -> bool:
        """Record an iterate.

        Returns:
            Whether to continue.
        """
        reference = self.reference or fit
        heldout = heldout_cost(fit)
        self.history.append(FitProgress(len(self.history), cost, heldout))
        logger.info(
            "Iteration %d: cost %.3f, held-out tracks %.3f", len(self.history) - 1, cost, heldout
        )
        if significantly_worse(fit, reference, self.stopping.significance):
            # above the cost of the start nothing is learned by heart yet: gaps are still closing
            self.waited += cost <= self.history[0].cost
        else:
            self.waited, self.best = 0, fit
        self.reference = fit if heldout <= heldout_cost(reference) else reference
        return self.waited < self.stopping.patience


def significantly_worse(
    fit: ParameterFit, reference: ParameterFit, significance: float = SIGNIFICANCE
) -> bool:
    """Whether a fit explains held-out tracks significantly worse than another.

    With d_i the increase of the cost of track i, it is worse if Σ d_i exceeds `significance` times
    (Σ d_i²)^½: a few tracks that contradict each other are no evidence.
    """
    increase = fit.heldout.simulated.cost - reference.heldout.simulated.cost
    return float(increase.sum()) > significance * float(increase.norm())


def heldout_cost(fit: ParameterFit) -> float:
    """Tracking cost of the held-out tracks."""
    return float(fit.heldout.simulated.cost.sum())


def in_prior_deviations(
    system: BlockArrowhead, simulator: TrackSimulator, theta: Float[Tensor, " p"]
) -> BlockArrowhead:
    """The equations for the values in prior standard deviations, with the priors added.

    In these units the priors are exactly quadratic, and a saturated soft clamp adds no curvature.
    """
    parameters = simulator.parameters
    scaled = system.scaled(parameters.prior.std / parameters.slope(theta))
    return scaled._replace(
        shared=scaled.shared + torch.eye(len(theta), dtype=theta.dtype),
        shared_gradient=scaled.shared_gradient + parameters.penalty(theta),
    )


def with_parameters(
    simulator: TrackSimulator, data: EstimationData, fit: ParameterFit, theta: Float[Tensor, " p"]
) -> ParameterFit:
    """The fit with another θ, unknowns of the fitted tracks as they were."""
    unknowns = fit.fitted.unknowns
    simulated = simulator.simulate(theta, data.fitted, unknowns)
    return fit._replace(theta=theta, fitted=fit.fitted._replace(simulated=simulated))


def total_cost(simulator: TrackSimulator, fit: ParameterFit) -> float:
    """Cost of the fitted tracks and of the prior; infinite if it is NaN."""
    penalty = 0.5 * simulator.parameters.penalty(fit.theta).square().sum()
    cost = float(fit.fitted.simulated.cost.sum() + penalty)
    return cost if cost == cost else float("inf")
