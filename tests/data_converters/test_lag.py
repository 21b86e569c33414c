"""Positions without the lag of the causal smoother."""

import numpy as np
import pytest

from data_converters import CausalSmoother
from data_converters.lag import response, without_lag

STEP_S = 0.1


def weave(time_s):
    """A ride that turns in the rhythm of a second, far from the origin."""
    across = 0.2 * np.sin(2.0 * np.pi * time_s)
    return np.stack([5.0 * time_s + 4e5, across - 3e6], -1)


def recorded(smoother, recorded_s, noise_m=0.0):
    """Times of the rows of a weave, and the rows."""
    time_s = recorded_s * np.arange(round(20.0 / recorded_s) + 1)
    first = np.ceil(smoother.ready_s(time_s) / STEP_S - 1e-6)
    at_s = STEP_S * np.arange(first, 201)
    noise = noise_m * np.random.default_rng(0).normal(size=(len(time_s), 2))
    return at_s, smoother(time_s, weave(time_s) + noise, at_s).value


@pytest.mark.parametrize("smoother", [CausalSmoother(), CausalSmoother(0.8, 1)], ids=repr)
@pytest.mark.parametrize("recorded_s", [0.04, 0.08, 0.1, 0.2])
def test_a_weave_comes_back(smoother, recorded_s):
    at_s, rows = recorded(smoother, recorded_s)
    settled = slice(round(smoother.window_s / STEP_S), -5)  # not at the ends
    found = without_lag(smoother, rows, STEP_S, recorded_s)
    assert np.abs(found - weave(at_s))[settled].max() < 0.012
    assert np.abs(rows - weave(at_s))[settled].max() > 0.1


def test_noise_is_no_more_than_that_of_the_samples():
    at_s, rows = recorded(CausalSmoother(), STEP_S, noise_m=0.02)
    found = without_lag(CausalSmoother(), rows, STEP_S, STEP_S)
    assert (found - weave(at_s))[12:].std() < 0.02


def test_a_recorded_step_that_was_rounded_is_that_of_the_rows():
    _, rows = recorded(CausalSmoother(), STEP_S)
    exact = without_lag(CausalSmoother(), rows, STEP_S, STEP_S)
    np.testing.assert_array_equal(without_lag(CausalSmoother(), rows, STEP_S, 0.0999), exact)
    found = without_lag(CausalSmoother(), rows, STEP_S, 0.0501)
    np.testing.assert_array_equal(found, without_lag(CausalSmoother(), rows, STEP_S, 0.05))


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_a_track_of_few_rows_stays_finite(rows):
    _, long = recorded(CausalSmoother(), STEP_S)
    for recorded_s in (0.02, 0.1, 0.5):
        found = without_lag(CausalSmoother(), long[:rows], STEP_S, recorded_s)
        assert found.shape == (rows, 2)
        assert np.isfinite(found).all()


@pytest.mark.parametrize("smoother", [CausalSmoother(), CausalSmoother(0.7, 3)], ids=repr)
@pytest.mark.parametrize("recorded_s", [0.02, 0.07, 0.5])
def test_response_is_what_the_smoother_does(smoother, recorded_s):
    time_s = recorded_s * np.arange(200)
    at_s = np.arange(smoother.ready_s(time_s), time_s[-1], 0.1)
    values = np.random.default_rng(0).normal(size=(200, 3))
    expected = smoother(time_s, values, at_s).value
    np.testing.assert_allclose(response(smoother, time_s, at_s) @ values, expected, atol=1e-9)
