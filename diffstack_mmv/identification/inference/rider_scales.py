"""Scales of the rider's jerk and curvature rate, estimated from the tracks."""

import logging
import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import ExtendedUnicycle
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.normal_equations import normal_equations
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.problem import COMMAND_DIM, INITIAL_DIM, TrackingProblem
from diffstack_mmv.identification.shooting.settings import TrackingSettings
from diffstack_mmv.identification.shooting.tracking import (
    LevenbergMarquardt,
    TrackingSolution,
    infer_controls,
)
from diffstack_mmv.identification.shooting.tracking_model import TrackingModel
from diffstack_mmv.identification.tracks.segments import TrackSegment, stack_segments
from diffstack_mmv.vehicles import VehicleSpec

logger = logging.getLogger(__name__)

MAX_ITERATIONS = 12
CORRELATION_S = 0.5  # over which errors of recorded positions are correlated
CONVERGED = 0.02  # relative change of a scale that ends the iterations
MAX_FACTOR = 30.0  # largest factor of a scale to its start
MIN_COUNT = 1e-6  # least number of rates that the tracks determine


def rate_scales(
    simulator: TrackSimulator, problem: TrackingProblem, solution: TrackingSolution
) -> Float[Tensor, "2"]:
    """Ratios of the scales of the rates (of acceleration, of curvature) to the assumed ones.

    (Σ ĉ² / Σ (1 - v))^½, where v is the posterior variance of a rate in units of its prior's: the
    squares of the inferred rates over the number of rates that the tracks determine. One if the
    assumed scales fit the tracks, or none of them was followed.

    Args:
        simulator: Model and residuals.
        problem: The tracks.
        solution: Their controls, inferred.
    """
    unknowns, simulated = solution.unknowns, solution.simulated
    if not bool(solution.converged.any()):
        logger.warning("No track tells how fast its rider acts. Are its velocities those of noise?")
        return unknowns.rates.new_ones(COMMAND_DIM)
    theta = simulator.parameters.start()
    jacobian = simulator.jacobian(theta, problem, unknowns, simulated, shared=False)
    local = normal_equations(jacobian, simulated.residual, unknowns).local
    variance = torch.cholesky_inverse(torch.linalg.cholesky(local)).diagonal(dim1=-2, dim2=-1)
    determined = 1 - variance[:, INITIAL_DIM:].unflatten(-1, (-1, COMMAND_DIM))
    found = solution.converged.to(local)[:, None, None]
    squares = (unknowns.rates.square() * found).sum((0, 1))
    return (squares / (determined * found).sum((0, 1)).clamp_min(MIN_COUNT)).sqrt()


@torch.no_grad()
def estimate_rider_scales(
    settings: TrackingSettings,
    spec: VehicleSpec,
    segments: Sequence[TrackSegment],
    dt_s: float,
    smoothed: bool = True,
) -> TrackingSettings:
    """Scales of the rider's rates of maximal evidence, the same for every model.

    The evidence is maximised on an extended unicycle, which has no physical parameter that could
    compensate for the rider. Smoothed positions that are closer than a smoother's window or a
    recorded step are not independent, and would make riders seem slow: one every half a second
    counts, with the noise of the mean of all of them.

    Args:
        settings: Noise, and scales to begin with.
        spec: The vehicle, of which only the limits matter.
        segments: The tracks.
        dt_s: Their step in s.
        smoothed: Whether errors of their positions are correlated.

    Returns:
        The settings with `jerk_mps3` and `curvature_rate` changed.

    Source:
        MacKay, Bayesian interpolation, Neural Computation 4, 1992 (fixed point of the evidence).
    """
    given, few = settings, LevenbergMarquardt(30)
    every = max(round(CORRELATION_S / dt_s), 1) if smoothed else 1
    first = settings = replace(
        given,
        along_m=given.along_m / math.sqrt(every),
        across_m=given.across_m / math.sqrt(every),
        control_noise=None,
        steer_rate_radps=None,
        segment_steps=None,
    )
    for _ in range(MAX_ITERATIONS):
        model = ExtendedUnicycle(spec, dt_s).double()
        vehicle = TrackingModel(model, settings).double()
        simulator = TrackSimulator(vehicle, ParameterVector(model, spec))
        problem = thin_samples(vehicle.problem(stack_segments(segments)), every)
        theta = simulator.parameters.start()
        solution = infer_controls(simulator, theta, problem, problem.guess, few)
        scales = rate_scales(simulator, problem, solution)
        jerk, curvature = scales.tolist()
        settings = replace(
            settings,
            jerk_mps3=_within_factor(first.jerk_mps3, settings.jerk_mps3 * jerk),
            curvature_rate=_within_factor(
                first.curvature_rate, settings.curvature_rate * curvature
            ),
        )
        if bool((scales.log().abs() < CONVERGED).all()):
            break
    logger.info(
        "The rider changes acceleration by %.2f m/s³ and curvature by %.3f 1/(m s)",
        settings.jerk_mps3,
        settings.curvature_rate,
    )
    return replace(given, jerk_mps3=settings.jerk_mps3, curvature_rate=settings.curvature_rate)


def thin_samples(problem: TrackingProblem, every: int) -> TrackingProblem:
    """The problem with weight on one of every `every` samples only; for single shooting."""
    weight = torch.zeros_like(problem.measurements.weight)
    weight[:, ::every] = problem.measurements.weight[:, ::every]
    return problem._replace(measurements=problem.measurements._replace(weight=weight))


def _within_factor(first: float, value: float) -> float:
    """Keep a scale within a factor of its start."""
    return min(max(value, first / MAX_FACTOR), first * MAX_FACTOR)
