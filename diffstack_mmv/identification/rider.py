"""How fast a rider changes acceleration and curvature, as the tracks themselves tell it."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import ExtendedUnicycle
from diffstack_mmv.identification.linearisation import Tracker, normal_equations
from diffstack_mmv.identification.parameters import LearnedParameters
from diffstack_mmv.identification.problem import (
    INTENTION,
    PLACEMENT,
    Problem,
    TrackedVehicle,
    TrackingSettings,
)
from diffstack_mmv.identification.stretches import Stretch, batch
from diffstack_mmv.identification.tracking import LevenbergMarquardt, Tracked, track
from diffstack_mmv.vehicles import VehicleSpec

logger = logging.getLogger(__name__)

ROUNDS = 12
SETTLED = 0.02  # relative change of a scale that ends the rounds
EAGER = 1.5  # exponent of the change per round: plain rounds approach from one side, slowly
FARTHEST = 10.0  # from where it began, either way


def rate_scales(tracker: Tracker, problem: Problem, tracked: Tracked) -> Float[Tensor, "2"]:
    """Root mean square rates of acceleration and curvature over the assumed ones.

    The expectation of |c|² counts what the tracks leave open, too: ĉ² plus its posterior variance.
    One if the assumed scales fit the tracks.

    Args:
        tracker: Model and residuals.
        problem: The tracks.
        tracked: Their controls.
    """
    unknowns, simulated, _ = tracked
    theta = tracker.parameters.start()
    jacobian = tracker.jacobian(theta, problem, unknowns, simulated, shared=False)
    own = normal_equations(jacobian, simulated.residual, unknowns).own
    variance = torch.cholesky_inverse(torch.linalg.cholesky(own)).diagonal(dim1=-2, dim2=-1)
    open_rates = variance[:, PLACEMENT:].unflatten(-1, (-1, INTENTION))
    driven = problem.targets.weight[:, 1:].unsqueeze(-1)
    expected = (unknowns.rates.square() + open_rates) * driven
    return (expected.sum((0, 1)) / driven.sum()).sqrt()


@torch.no_grad()
def ridden(
    settings: TrackingSettings, spec: VehicleSpec, stretches: Sequence[Stretch], dt_s: float
) -> TrackingSettings:
    """Scales of the rider's rates that make the tracks most likely, for every model the same.

    Expectation maximisation on an extended unicycle, which has no physical parameter that could
    take the rider's part.

    Args:
        settings: Noise, and scales to begin with.
        spec: The vehicle, of which only the limits matter.
        stretches: The tracks.
        dt_s: Their step in s.

    Returns:
        The settings with `jerk_mps3` and `curvature_rate` changed.

    Source: Dempster, Laird and Rubin, Maximum likelihood from incomplete data via the EM
        algorithm, 1977.
    """
    first, few = settings, LevenbergMarquardt(20)
    for _ in range(ROUNDS):
        model = ExtendedUnicycle(spec, dt_s).double()
        vehicle = TrackedVehicle(model, settings).double()
        tracker = Tracker(vehicle, LearnedParameters(model, spec))
        problem = vehicle.problem(batch(stretches))
        tracked = track(tracker, tracker.parameters.start(), problem, problem.guess, few)
        scales = rate_scales(tracker, problem, tracked)
        jerk, turning = scales.pow(EAGER).tolist()
        settings = replace(
            settings,
            jerk_mps3=_near(first.jerk_mps3, settings.jerk_mps3 * jerk),
            curvature_rate=_near(first.curvature_rate, settings.curvature_rate * turning),
        )
        if bool((scales.log().abs() < SETTLED).all()):
            break
    logger.info(
        "The rider changes acceleration by %.2f m/s³ and curvature by %.3f 1/(m s)",
        settings.jerk_mps3,
        settings.curvature_rate,
    )
    return settings


def _near(first: float, value: float) -> float:
    """Keep a scale within reach of where it began."""
    return min(max(value, first / FARTHEST), first * FARTHEST)
