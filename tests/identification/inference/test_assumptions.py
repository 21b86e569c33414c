"""What is assumed of noise and rider."""

import pytest

from diffstack_mmv.identification import Recordings, TrackingAssumptions
from tests.identification.conftest import segment_along_circle

KNOWN_RIDER = {"jerk_mps3": 2.0, "curvature_rate": 0.4}


def settings(spec, noise_m=None, **given):
    recordings = Recordings({}, noise_m=noise_m)
    segments = [segment_along_circle("a"), segment_along_circle("b", curvature=0.1)]
    return TrackingAssumptions(**given).settings(recordings, spec, segments, 0.1)


@pytest.mark.parametrize(
    ("recorded", "given", "expected"),
    [
        (None, {}, (0.08, 0.06)),
        ((0.03, 0.02), {}, (0.03, 0.02)),
        ((0.03, 0.02), {"along_m": 0.1}, (0.1, 0.02)),
    ],
    ids=["neither", "recorded", "given"],
)
def test_noise_is_as_given_else_as_recorded(bicycle, recorded, given, expected):
    found = settings(bicycle, recorded, **KNOWN_RIDER, **given)
    assert (found.along_m, found.across_m) == expected


@pytest.mark.parametrize("noise_m", [(0.03, 0.0), (0.03, 1e-13)])
def test_noise_that_no_recording_tells_must_be_given(bicycle, noise_m):
    told = r"`noise\.across_m` must be given where the recordings tell no noise, but got"
    with pytest.raises(ValueError, match=told):
        settings(bicycle, noise_m, **KNOWN_RIDER)
    assert settings(bicycle, noise_m, **KNOWN_RIDER, across_m=0.02).across_m == 0.02


@pytest.mark.slow
def test_rate_that_is_given_stays_and_the_other_is_estimated(bicycle):
    found = settings(bicycle, (0.03, 0.03), jerk_mps3=2.0)
    assert found.jerk_mps3 == 2.0
    assert found.curvature_rate < 0.5


@pytest.mark.parametrize("steps", [None, 7])
def test_no_limit_of_the_shooting_intervals_is_single_shooting(bicycle, steps):
    assert settings(bicycle, **KNOWN_RIDER, segment_steps=steps).segment_steps == steps


def test_noise_of_recorded_controls_keeps_their_order(bicycle):
    controls = {"acceleration": 0.05, "steer": 0.002}
    assert settings(bicycle, **KNOWN_RIDER, controls=controls).control_noise == (0.05, 0.002)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"along_m": -1.0}, "`along_m` must be positive, but got -1.0"),
        ({"controls": {"steer": 0.0}}, "`controls.steer` must be positive, but got 0.0"),
        ({"segment_steps": 0}, "`segment_steps` must be positive"),
    ],
)
def test_deviations_that_are_not_positive_are_refused_by_name(given, told):
    with pytest.raises(ValueError, match=told):
        TrackingAssumptions(**given)
