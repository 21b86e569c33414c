"""What was recorded beside a track, behind the smoother of the track."""

import numpy as np
import pytest

from data_converters import (
    CausalSmoother,
    ConversionError,
    DrivenTrack,
    Sampling,
    Unsmoothed,
    ZeroPhaseSmoother,
    matched,
    smoother_of,
)
from data_converters.beside import smoothed_beside

STEP_S = 0.1
SAMPLING = Sampling(0.6, STEP_S)


@pytest.mark.parametrize(
    "smoother", [CausalSmoother(0.8), Unsmoothed(), ZeroPhaseSmoother(0.7)], ids=str
)
def test_smoother_is_built_from_what_a_cache_holds(smoother):
    assert smoother_of(smoother.settings()) == smoother


def test_unknown_smoother_is_refused():
    with pytest.raises(ConversionError, match="`smoother` must be one of CausalSmoother"):
        smoother_of({"name": "Median", "lookahead_s": 0.0})


def test_each_run_is_smoothed_by_itself():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(40, 2))
    values[20:22] = np.nan
    values[37] = np.nan  # the two rows after it are too few
    smoother, time_s = ZeroPhaseSmoother(), STEP_S * np.arange(20)
    found = smoothed_beside(smoother, values, STEP_S)
    np.testing.assert_array_equal(found[:20], smoother(time_s, values[:20], time_s).value)
    assert np.isfinite(found[22:37]).all()
    assert np.isnan(found[[20, 21, 37, 38, 39]]).all()


def test_causal_smoother_knows_nothing_in_its_warm_up():
    found = smoothed_beside(CausalSmoother(), np.ones((30, 1)), STEP_S)
    assert np.isnan(found[:6]).all()
    np.testing.assert_allclose(found[6:], 1.0)


def test_samples_as_they_are_stay():
    values = np.random.default_rng(1).normal(size=(20, 2))
    np.testing.assert_array_equal(smoothed_beside(Unsmoothed(), values, STEP_S), values)


def driven(smoother, rows=80, wheelbase_m=1.05):
    """A slalom of 1.2 s a period at 5 m/s as a conversion leaves it, and its steering."""
    time_s = STEP_S * np.arange(rows + 6)
    steer = 0.25 * np.sin(2.0 * np.pi * time_s / 1.2)
    course = np.cumsum(STEP_S * 5.0 * np.tan(steer) / wheelbase_m)
    course = np.concatenate([[0.0], course[:-1]])
    step = STEP_S * 5.0 * np.stack([np.cos(course), np.sin(course)], -1)
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(step, 0)[:-1]])
    smooth = smoother(time_s, position, time_s).value
    known = np.isfinite(smooth).all(-1)
    steered = np.stack([np.zeros_like(steer), steer], -1)
    return DrivenTrack(smooth[known], steered[known], np.zeros(known.sum(), dtype=bool))


def told_wheelbase(track):
    """The wheelbase that positions and steering of a slalom tell by least squares, in m."""
    step = np.diff(track.position, axis=0)
    turned = np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
    asked = STEP_S * 5.0 * np.tan(track.controls[: len(turned), 1])
    known = np.isfinite(asked)
    known[-6:] = False  # at the end the motion is less certain
    return float((asked[known] ** 2).sum() / (asked * turned)[known].sum())


def test_controls_tell_the_wheelbase_behind_the_causal_smoother():
    track = driven(CausalSmoother())
    assert told_wheelbase(matched(CausalSmoother(), track, STEP_S, SAMPLING)) == pytest.approx(
        1.05, rel=0.01
    )
    assert abs(told_wheelbase(track) - 1.05) > 0.1


def test_controls_are_unknown_where_the_lag_could_not_be_undone():
    track = driven(CausalSmoother())
    track.bridged[30:32] = True
    found = matched(CausalSmoother(), track, STEP_S, SAMPLING)
    unknown = [*range(12), *range(30, 43)]
    assert np.flatnonzero(np.isnan(found.controls[:, 1])).tolist() == unknown
    assert np.isfinite(found.position).all()
    known = np.setdiff1d(np.arange(len(found.controls)), unknown)
    np.testing.assert_array_equal(found.controls[known], track.controls[known])


@pytest.mark.parametrize("smoother", [Unsmoothed(), ZeroPhaseSmoother()], ids=str)
def test_positions_without_a_lag_stay_and_controls_pass_through_their_smoother(smoother):
    track = driven(smoother)
    found = matched(smoother, track, STEP_S, SAMPLING)
    np.testing.assert_array_equal(found.position, track.position)
    passed = smoothed_beside(smoother, track.controls, STEP_S)
    np.testing.assert_array_equal(found.controls, passed)
