"""Positions without the lag of the causal smoother."""

import numpy as np
import pytest

from data_converters import CausalSmoother, Sampling, from_the_first_sample
from data_converters.lag import CUTOFF_HZ, response, without_lag

STEP_S = 0.1


def weave(time_s):
    """A ride that turns in the rhythm of a second, far from the origin."""
    across = 0.2 * np.sin(2.0 * np.pi * time_s)
    return np.stack([5.0 * time_s + 4e5, across - 3e6], -1)


def recorded(smoother, recorded_s, noise_m=0.0, begin_s=0.0):
    """Times of the rows of a weave, and the rows."""
    time_s = begin_s + recorded_s * np.arange(round(20.0 / recorded_s) + 1)
    first = np.ceil(smoother.ready_s(time_s) / STEP_S - 1e-6)
    at_s = STEP_S * np.arange(first, 201)
    noise = noise_m * np.random.default_rng(0).normal(size=(len(time_s), 2))
    return at_s, smoother(time_s, weave(time_s) + noise, at_s).value


@pytest.mark.parametrize("smoother", [CausalSmoother(), CausalSmoother(0.8, 1)], ids=repr)
@pytest.mark.parametrize("recorded_s", [0.04, 0.08, 0.1, 0.2])
def test_a_weave_comes_back(smoother, recorded_s):
    at_s, rows = recorded(smoother, recorded_s)
    settled = slice(round(smoother.window_s / STEP_S), -5)  # not at the ends
    sampling = from_the_first_sample(smoother, STEP_S, recorded_s)
    found = without_lag(smoother, rows, STEP_S, sampling)
    assert np.abs(found - weave(at_s))[settled].max() < 0.012
    assert np.abs(rows - weave(at_s))[settled].max() > 0.1


@pytest.mark.parametrize("begin_s", [0.02, 0.05, 0.08])
@pytest.mark.parametrize("recorded_s", [0.08, 0.1, 0.2])
def test_samples_beside_the_rows_are_told(recorded_s, begin_s):
    smoother = CausalSmoother()
    at_s, rows = recorded(smoother, recorded_s, begin_s=begin_s)
    found = without_lag(smoother, rows, STEP_S, Sampling(at_s[0] - begin_s, recorded_s))
    assert np.abs(found - weave(at_s))[13:-5].max() < 0.012


def test_a_first_row_that_a_regular_recording_has_not_yet_stays_finite():
    _, rows = recorded(CausalSmoother(), STEP_S)
    found = without_lag(CausalSmoother(), rows, STEP_S, Sampling(0.59, STEP_S))
    assert np.isfinite(found).all()


@pytest.mark.parametrize("step_s", [0.05, 0.1])
def test_half_of_an_amplitude_is_left_at_the_cutoff(step_s):
    time_s = step_s * np.arange(400)
    turns = 2.0 * np.pi * CUTOFF_HZ * time_s
    wave = np.stack([np.sin(turns), np.cos(turns)], -1)
    at_s = time_s[np.searchsorted(time_s, CausalSmoother().ready_s(time_s) - 1e-6) :]
    rows = CausalSmoother()(time_s, wave, at_s).value
    sampling = from_the_first_sample(CausalSmoother(), step_s, step_s)
    found = without_lag(CausalSmoother(), rows, step_s, sampling)
    left = (found * wave[-len(at_s) :]).sum(1)[50:-50]
    assert left.mean() == pytest.approx(0.5, abs=0.01)


def test_noise_is_no_more_than_that_of_the_samples():
    at_s, rows = recorded(CausalSmoother(), STEP_S, noise_m=0.02)
    sampling = from_the_first_sample(CausalSmoother(), STEP_S, STEP_S)
    found = without_lag(CausalSmoother(), rows, STEP_S, sampling)
    assert (found - weave(at_s))[12:].std() < 0.02


@pytest.mark.parametrize(
    ("rounded_s", "step_s"),
    [
        *((0.0999, 0.1), (0.0501, 0.05), (0.0204, 0.02), (0.2039, 0.2)),
        *((0.08, 0.08), (0.0205, 0.0205), (0.2042, 0.2042)),
    ],
)
def test_a_recorded_step_that_was_rounded_is_that_of_the_rows(rounded_s, step_s):
    found = from_the_first_sample(CausalSmoother(), STEP_S, rounded_s)
    assert found == pytest.approx((0.6, step_s))


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_a_track_of_few_rows_stays_finite(rows):
    _, long = recorded(CausalSmoother(), STEP_S)
    for recorded_s in (0.02, 0.1, 0.5):
        sampling = from_the_first_sample(CausalSmoother(), STEP_S, recorded_s)
        found = without_lag(CausalSmoother(), long[:rows], STEP_S, sampling)
        assert found.shape == (rows, 2)
        assert np.isfinite(found).all()


@pytest.mark.parametrize("smoother", [CausalSmoother(), CausalSmoother(0.7, 3)], ids=repr)
@pytest.mark.parametrize("recorded_s", [0.02, 0.07, 0.5])
def test_response_is_what_the_smoother_does(smoother, recorded_s):
    time_s = 40.0 + recorded_s * np.arange(200)
    at_s = np.arange(smoother.ready_s(time_s), time_s[-1], 0.1)
    values = np.random.default_rng(0).normal(size=(200, 3))
    expected = smoother(time_s, values, at_s).value
    np.testing.assert_allclose(response(smoother, time_s, at_s) @ values, expected, atol=1e-9)
