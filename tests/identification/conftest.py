"""Small identification problems of vehicles that are known."""

from contextlib import contextmanager

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.dynamics.manoeuvres import Slalom, Turn
from diffstack_mmv.identification import (
    DataSplit,
    IdentificationProblem,
    ParameterVector,
    TrackingSettings,
    TrackSegment,
)
from diffstack_mmv.identification.tracks.synthetic import MeasurementModel, record_manoeuvres
from diffstack_mmv.vehicles import load_vehicle

NOISE_M = 0.02
CONTROL_NOISE = (0.05, 0.002)
LIVELY = (Slalom(4.0, 0.22, 1.2, 1), Slalom(6.0, 0.1, 0.8, 2), Turn(7.0, -0.9, 10.0, 0.5, 0.2))
LAZY = (Slalom(2.0, 0.001, 1.2, 1), Slalom(2.5, 0.001, 1.0, 1))


@contextmanager
def double_precision():
    """Makes float64 the default, for fixtures of a module."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def synthetic_problem(
    dynamics, truth, known=True, manoeuvres=LIVELY, seed=0, parameters=None, **kw
):
    """A problem of a vehicle whose parameters differ from the priors by `truth` (name: value)."""
    generator = torch.Generator().manual_seed(seed)
    spec = load_vehicle("bicycle")
    finer = 10 if model_of(spec, dynamics, 0.1).acts_a_step_late else 1
    actual = model_of(spec, dynamics, 0.1 / finer).double()
    if truth:
        learned = ParameterVector(actual, spec)
        values = learned.prior.mean.clone()
        for name, value in truth.items():
            values[learned.names.index(name)] = value
        learned.store(learned.theta_for(values))
    noise = CONTROL_NOISE if known else None
    measurement = MeasurementModel(NOISE_M, noise, finer)
    fitted, heldout = (
        record_manoeuvres(actual, spec, each, measurement, generator)
        for each in (manoeuvres, manoeuvres[:1])
    )
    settings = TrackingSettings(NOISE_M, NOISE_M, 20.0, 2.0, control_noise=noise, **kw)
    split = DataSplit(fitted, heldout)
    return IdentificationProblem.of(
        model_of(spec, dynamics, 0.1), spec, split, settings, parameters
    )


def segment_along_circle(recording, start=0, steps=30, curvature=0.0):
    """A segment at 5 m/s along a circle, a line by default."""
    course = 5.0 * curvature * 0.1 * torch.arange(steps + 1)
    heading = torch.stack([course[:-1].cos(), course[:-1].sin()], -1)
    position = torch.cat([torch.zeros(1, 2), 0.5 * heading.cumsum(0)])
    return TrackSegment(f"{recording}@{start}s", position, course, torch.full((steps + 1,), 5.0))


@pytest.fixture(autouse=True)
def exact(double):
    """All of identification works in float64."""


@pytest.fixture(scope="session")
def bicycle():
    return load_vehicle("bicycle")
