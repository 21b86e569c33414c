"""How fast a rider changes acceleration and curvature, as the tracks themselves tell it."""

import logging
import math
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
INDEPENDENT_S = 0.5
SETTLED = 0.02  # relative change of a scale that ends the rounds
FARTHEST = 30.0  # from where it began, either way
LEAST = 1e-6  # number of rates that the tracks determine


def rate_scales(tracker: Tracker, problem: Problem, tracked: Tracked) -> Float[Tensor, "2"]:
    """Scales of the rates of acceleration and curvature over the assumed ones.

    Σ ĉ² / Σ (1 - v), where v is the posterior variance of a rate in units of its prior's: the rates
    that were inferred, over the number of those that the tracks determine. One if the assumed
    scales fit the tracks.

    Args:
        tracker: Model and residuals.
        problem: The tracks.
        tracked: Their controls.
    """
    unknowns, simulated = tracked.unknowns, tracked.simulated
    theta = tracker.parameters.start()
    jacobian = tracker.jacobian(theta, problem, unknowns, simulated, shared=False)
    own = normal_equations(jacobian, simulated.residual, unknowns).own
    variance = torch.cholesky_inverse(torch.linalg.cholesky(own)).diagonal(dim1=-2, dim2=-1)
    determined = 1 - variance[:, PLACEMENT:].unflatten(-1, (-1, INTENTION))
    found = tracked.converged.to(own)[:, None, None]
    squares = (unknowns.rates.square() * found).sum((0, 1))
    return (squares / (determined * found).sum((0, 1)).clamp_min(LEAST)).sqrt()


@torch.no_grad()
def ridden(
    settings: TrackingSettings, spec: VehicleSpec, stretches: Sequence[Stretch], dt_s: float
) -> TrackingSettings:
    """Scales of the rider's rates that make the tracks most likely, for every model the same.

    The evidence is maximised on an extended unicycle, which has no physical parameter that could
    take the rider's part. Positions that are closer than a smoother's window or a recorded step are
    not independent, and would make riders look slow: one every half a second counts, with the
    noise that all of them together have.

    Args:
        settings: Noise, and scales to begin with.
        spec: The vehicle, of which only the limits matter.
        stretches: The tracks.
        dt_s: Their step in s.

    Returns:
        The settings with `jerk_mps3` and `curvature_rate` changed.

    Source: MacKay, Bayesian interpolation, Neural Computation 4, 1992 (fixed point of the
        evidence).
    """
    given, few = settings, LevenbergMarquardt(30)
    every = max(round(INDEPENDENT_S / dt_s), 1)
    first = settings = replace(
        given,
        along_m=given.along_m / math.sqrt(every),
        across_m=given.across_m / math.sqrt(every),
        control_noise=None,
        steer_rate_radps=None,
        segment_steps=None,
    )
    for _ in range(ROUNDS):
        model = ExtendedUnicycle(spec, dt_s).double()
        vehicle = TrackedVehicle(model, settings).double()
        tracker = Tracker(vehicle, LearnedParameters(model, spec))
        problem = thinned(vehicle.problem(batch(stretches)), every)
        theta = tracker.parameters.start()
        tracked = track(tracker, theta, problem, problem.guess, few)
        scales = rate_scales(tracker, problem, tracked)
        jerk, turning = scales.tolist()
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
    return replace(given, jerk_mps3=settings.jerk_mps3, curvature_rate=settings.curvature_rate)


def thinned(problem: Problem, every: int) -> Problem:
    """The problem in which one sample of so many weighs; for single shooting."""
    weight = torch.zeros_like(problem.targets.weight)
    weight[:, ::every] = problem.targets.weight[:, ::every]
    return problem._replace(targets=problem.targets._replace(weight=weight))


def _near(first: float, value: float) -> float:
    """Keep a scale within reach of where it began."""
    return min(max(value, first / FARTHEST), first * FARTHEST)
