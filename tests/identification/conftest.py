"""Small identification problems of vehicles that are known."""

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.dynamics.manoeuvres import Slalom, Turn
from diffstack_mmv.identification import Case, Division, LearnedParameters, TrackingSettings
from diffstack_mmv.identification.synthetic import Recorder, record_manoeuvres
from diffstack_mmv.vehicles import load_vehicle

NOISE_M = 0.02
CONTROL_NOISE = (0.05, 0.002)
LIVELY = (Slalom(4.0, 0.22, 1.2, 1), Slalom(6.0, 0.1, 0.8, 2), Turn(7.0, -0.9, 10.0, 0.5, 0.2))
LAZY = (Slalom(2.0, 0.001, 1.2, 1), Slalom(2.5, 0.001, 1.0, 1))


def synthetic_case(dynamics, truth, known=True, manoeuvres=LIVELY, seed=0, parameters=None, **kw):
    """The case of a vehicle whose parameters differ from their priors by `truth` (name: value)."""
    generator = torch.Generator().manual_seed(seed)
    spec = load_vehicle("bicycle")
    actual = model_of(spec, dynamics, 0.1).double()
    if truth:
        learned = LearnedParameters(actual, spec)
        values = learned.prior.mean.clone()
        for name, value in truth.items():
            values[learned.names.index(name)] = value
        learned.store(learned.theta_for(values))
    noise = CONTROL_NOISE if known else None
    recorder = Recorder(NOISE_M, noise)
    fitted, heldout = (
        record_manoeuvres(actual, spec, each, recorder, generator)
        for each in (manoeuvres, manoeuvres[:1])
    )
    settings = TrackingSettings(NOISE_M, NOISE_M, 20.0, 2.0, control_noise=noise, **kw)
    division = Division(fitted, heldout)
    return Case.of(model_of(spec, dynamics, 0.1), spec, division, settings, parameters)


@pytest.fixture(autouse=True)
def exact(double):
    """All of identification works in float64."""


@pytest.fixture(scope="session")
def bicycle():
    return load_vehicle("bicycle")
