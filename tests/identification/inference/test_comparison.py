"""Models on the same segments."""

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import (
    DataSplit,
    Identifier,
    ModelComparison,
    TrackingSettings,
    cross_validation_splits,
)
from tests.identification.conftest import segment_along_circle


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
