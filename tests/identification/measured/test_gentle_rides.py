"""Fast and gentle rides: what is eliminated depends strongly on the height of the antenna."""

import math
from functools import partial

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import ParameterVector
from diffstack_mmv.identification.measured import (
    InstrumentPriors,
    MeasuredFit,
    MeasuredFitter,
    MeasuredRide,
    MeasuredStudy,
    MeasurementNoise,
    RideSimulator,
    RideWindowSettings,
    cut_windows,
)
from diffstack_mmv.identification.measured.elimination import RideEquations
from diffstack_mmv.identification.measured.volume import tilt_change, volume_slopes
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import load_vehicle

WHEELBASE_M, HEIGHT_M, AHEAD_M, FINE_S, FINE = 1.1, 1.0, 0.3, 0.005, 20


def gentle_ride(number: int, generator: torch.Generator, length_s: float = 30.0) -> MeasuredRide:
    """A ride at 8 m/s in continuous time, the antenna aside by its height times the lean."""

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator)

    steps = round(length_s / FINE_S / FINE)
    time_s = FINE_S * torch.arange(steps * FINE + FINE, dtype=torch.float64)
    first, second, third = (2 * math.pi * torch.rand(3, generator=generator)).tolist()
    steer = 0.016 * (0.7 * time_s + first).sin() + 0.01 * (1.7 * time_s + second).sin()
    speed = 8 + 0.8 * (0.5 * time_s + third).sin()
    turn = speed * steer.tan() / WHEELBASE_M
    course = (FINE_S * turn).cumsum(0) - FINE_S * turn
    axle = [FINE_S * (speed * way).cumsum(0) for way in (course.cos(), course.sin())]
    aside = HEIGHT_M * torch.atan(speed * turn / GRAVITY)
    x = axle[0] + AHEAD_M * course.cos() - aside * course.sin()
    y = axle[1] + AHEAD_M * course.sin() + aside * course.cos()
    place = torch.stack([x, y], -1)[::FINE] + 0.01 * normal(steps + 1, 2)
    steer, speed = (each.unflatten(0, (-1, FINE)).mean(-1) for each in (steer, speed))
    known = torch.ones(steps + 1, dtype=torch.bool)
    return MeasuredRide(f"ride_{number}/one", place, known, steer + 0.001 * normal(1), speed)


@pytest.fixture(scope="module")
def ridden():
    spec, generator = load_vehicle("bicycle"), torch.Generator().manual_seed(0)
    return spec, [gentle_ride(number, generator) for number in range(4)]


def left(equations: RideEquations, fit: MeasuredFit) -> torch.Tensor:
    """What Newton's step from the end of a fit would still change, in deviations (s)."""
    gradient = fit.reduced.gradient.sum(0) + equations.shared.penalty(fit.point.shared)
    return fit.covariance @ gradient / fit.covariance.diagonal().sqrt()


@pytest.mark.parametrize("rounds", [0, 1])
def test_the_slope_of_the_volume_is_that_where_the_fit_ends(ridden, rounds):
    spec, rides = ridden
    study = MeasuredStudy(spec, noise_rounds=rounds)
    windows, _, (simulator, fit) = study.whole(rides, "kbm", partial(model_of, spec, "kbm", 0.1))
    priors = fit.instruments.given
    equations = RideEquations(simulator, windows, priors, False, fit.point, fit.tilt)
    assert fit.converged
    assert tilt_change(equations, equations.linearised(fit.point)).gain < 0.1


def test_a_fit_that_is_told_to_have_converged_has_no_step_left(ridden):
    spec, rides = ridden
    model = model_of(spec, "kbm", 0.1).double()
    simulator = RideSimulator(model, ParameterVector(model, spec), MeasurementNoise(), spec)
    windows, fitter = cut_windows(rides, RideWindowSettings()), MeasuredFitter()
    start = fitter.first_point(simulator, windows)
    level = torch.zeros(len(windows.names), len(start.shared), dtype=torch.float64)
    joint = fitter(simulator, windows, start, level)
    equations = RideEquations(simulator, windows, InstrumentPriors(), False, joint.point)
    slopes = volume_slopes(equations, equations.linearised(joint.point))
    steep = fitter(simulator, windows, joint.point, slopes)  # so far that windows are damped much
    for fit in (joint, steep):
        assert not fit.converged or float(left(equations, fit).abs().max()) < 0.5
    assert joint.converged
