"""A verdict rests on what the tracks excite: rides of one speed say little of another."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.dynamics.manoeuvres import Slalom, Turn
from diffstack_mmv.identification import (
    DataSplit,
    IdentifiabilityThresholds,
    IdentificationProblem,
    Identifier,
    TrackingSettings,
)
from diffstack_mmv.identification.inference.combinations import combinations
from diffstack_mmv.identification.tracks.synthetic import MeasurementModel, record_manoeuvres
from tests.identification.conftest import CONTROL_NOISE, NOISE_M

LONGER = 1.1
STEERING = "steer_per_curvature_at_5_mps"


def rides(speed):
    """A slalom and two turns at about one speed, in m/s."""
    return [
        Slalom(speed, 0.05, 1.5, 2),
        Turn(speed, 1.2, 14.0, 0.6, 0.5),
        Turn(speed - 0.2, -1.0, 18.0, 0.4, 0.5),
    ]


def told(bicycle, speeds, seed=0):
    """What is found of a bicycle a tenth longer than its file says, and its true steering."""
    spec = replace(
        bicycle,
        parameters={
            name: replace(each, tied=each.length is not None)
            for name, each in bicycle.parameters.items()
        },
    )
    wheels = tuple(replace(wheel, x_m=LONGER * wheel.x_m) for wheel in spec.wheels)
    wheelbase = replace(spec.wheelbase, initial=LONGER * spec.wheelbase.initial)
    actual = model_of(replace(spec, wheels=wheels, wheelbase=wheelbase), "gm3", 0.1).double()
    generator = torch.Generator().manual_seed(seed)
    manoeuvres = [each for speed in speeds for each in rides(speed)]
    fitted, heldout = (
        record_manoeuvres(actual, spec, each, MeasurementModel(NOISE_M, CONTROL_NOISE), generator)
        for each in (manoeuvres, manoeuvres[:1])
    )
    settings = TrackingSettings(NOISE_M, NOISE_M, 20.0, 2.0, control_noise=CONTROL_NOISE)
    problem = IdentificationProblem.of(
        model_of(spec, "gm3", 0.1), spec, DataSplit(fitted, heldout), settings
    )
    found = Identifier(starts=0)(problem.simulator, problem.data)
    parameters = problem.simulator.parameters
    rows = combinations(
        problem.simulator.vehicle.model, parameters, found.optima, IdentifiabilityThresholds()
    )
    verdicts = dict(zip(parameters.names, map(str, found.identifiability), strict=True))
    (row,) = [each for each in rows if each.name == STEERING]
    return verdicts, row, float(actual.derived_quantities()[STEERING].value.detach())


@pytest.mark.slow
def test_rides_at_8_mps_do_not_tell_the_steering_at_5(bicycle):
    """Wheel positions taken for exact gave 1.115 ± 0.009 m, "identifiable"; the truth is 1.183."""
    verdicts, row, truth = told(bicycle, [8.0])
    assert row.verdict == "only in combination"
    assert abs(row.estimate - truth) < 2 * row.std
    assert verdicts["length_scale"] in ("only in combination", "not identifiable")


@pytest.mark.slow
def test_rides_at_speeds_around_5_mps_tell_the_steering_there(bicycle):
    verdicts, row, truth = told(bicycle, [3.0, 5.0, 8.0])
    assert row.verdict == "identifiable"
    assert abs(row.estimate - truth) < 2 * row.std < 0.03 * truth
    assert verdicts["roll_inertia"] == "not identifiable"
