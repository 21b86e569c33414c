"""Models on the same segments."""

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.dynamics.manoeuvres import Slalom, Turn
from diffstack_mmv.identification import (
    DataSplit,
    Identifier,
    ModelComparison,
    TrackingSettings,
    TrackSegment,
    cross_validation_splits,
)
from diffstack_mmv.identification.report.remarks import simulated_controls
from diffstack_mmv.identification.tracks.synthetic import MeasurementModel, record_manoeuvres
from tests.identification.conftest import CONTROL_NOISE, segment_along_circle

RIDES = (Turn(5.0, 2.0, 5.5, 0.4, 0.5), Slalom(4.0, 0.22, 1.2, 4), Turn(7.0, -1.6, 10.0))


@pytest.fixture
def unicycle(bicycle):
    return lambda: model_of(bicycle, "unicycle", 0.1)


def test_a_straight_ride_is_predicted_and_a_turn_that_begins_is_not(bicycle, unicycle):
    straight, turning = segment_along_circle("a"), segment_along_circle("b")
    bend = segment_along_circle("c", steps=10, curvature=0.15).position
    position = torch.cat([straight.position[:21], straight.position[20] + bend[1:]])
    split = DataSplit([straight], [straight, turning._replace(position=position)])
    compare = ModelComparison(bicycle, split, TrackingSettings(), Identifier())
    errors = compare(unicycle).validation
    assert float(errors.prediction[0]) < 1e-3
    assert float(errors.prediction[1]) > 0.3
    assert float(errors.tracking[1]) < 0.1


def test_cross_validation_holds_out_every_segment(bicycle, unicycle):
    first, second, third = (segment_along_circle(name) for name in "abc")
    split = DataSplit([first, second], [third])
    folds = cross_validation_splits(split, 3, seed=0)
    compare = ModelComparison(bicycle, split, TrackingSettings(), Identifier(), 10, folds)
    assert compare(unicycle).validation.names == ("a@0s", "b@0s", "c@0s")


@pytest.mark.parametrize("finer", [1, 20], ids=["own steps", "vehicle"])
def test_the_tracks_tell_whose_steps_the_recorded_controls_were(bicycle, finer):
    """Taken for the other's, both wheelbases were 1 % off."""
    actual = model_of(bicycle, "kbm", 0.1 / finer).double()
    measurement = MeasurementModel(1e-3, CONTROL_NOISE, finer)
    generator = torch.Generator().manual_seed(0)
    cut = [
        TrackSegment(name, *(part[12:] for part in parts))
        for name, *parts, _, _ in record_manoeuvres(actual, bicycle, RIDES, measurement, generator)
    ]
    settings = TrackingSettings(1e-3, 1e-3, 20.0, 2.0, control_noise=CONTROL_NOISE)
    compare = ModelComparison(bicycle, DataSplit(cut, cut[:1]), settings, Identifier(starts=0))
    problem, found, _ = compare(lambda: model_of(bicycle, "kbm", 0.1))
    assert problem.simulator.vehicle.settings.own_steps == (finer == 1)
    assert bool(simulated_controls(problem.simulator)) == (finer == 1)
    told = float(problem.simulator.parameters.values(found.after.theta))
    assert told == pytest.approx(float(actual.wheelbase().detach()), rel=0.005)


def test_tracks_that_do_not_tell_are_those_of_a_vehicle(bicycle):
    straight = segment_along_circle("a")
    straight = straight._replace(controls=torch.zeros(31, 2))
    settings = TrackingSettings(control_noise=CONTROL_NOISE)
    split = DataSplit([straight], [straight])
    compare = ModelComparison(bicycle, split, settings, Identifier(starts=0))
    found = compare(lambda: model_of(bicycle, "kbm", 0.1))
    assert not found.problem.simulator.vehicle.settings.own_steps
