"""What a fit of physical parameters is, and when held-out tracks end it."""

import logging
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.identification.arrow import Arrow
from diffstack_mmv.identification.linearisation import Tracker
from diffstack_mmv.identification.problem import Problem
from diffstack_mmv.identification.tracking import Tracked

logger = logging.getLogger(__name__)

SIGNIFICANCE = 2.0  # standard deviations of a difference that is not chance


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


@runtime_checkable
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
