"""Smoothers: what they reproduce, what they look at, what they refuse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from data_converters import CausalSmoother, ConversionError, Unsmoothed, ZeroPhaseSmoother

SMOOTHERS = [
    ZeroPhaseSmoother(),
    CausalSmoother(),
    ZeroPhaseSmoother(order=3),
    CausalSmoother(order=3),
]


def irregular(rng, count=120, step=0.08):
    return np.cumsum(step * rng.uniform(0.5, 1.5, count))


@pytest.mark.parametrize("smoother", SMOOTHERS, ids=repr)
@given(st.integers(0, 1000), st.floats(-50, 50), st.floats(-15, 15), st.floats(-4, 4))
def test_constant_acceleration_comes_back_exactly_at_irregular_times(smoother, seed, p, v, a):
    time_s = irregular(np.random.default_rng(seed))
    values = (p + v * time_s + 0.5 * a * time_s**2)[:, None]
    at_s = np.linspace(smoother.ready_s(time_s), time_s[-1], 40)
    smooth = smoother(time_s, values, at_s)
    np.testing.assert_allclose(smooth.value[:, 0], p + v * at_s + 0.5 * a * at_s**2, atol=1e-6)
    np.testing.assert_allclose(smooth.rate[:, 0], v + a * at_s, atol=1e-5)
    np.testing.assert_allclose(smooth.curvature[:, 0], a, atol=1e-3)


def test_zero_phase_is_the_filter_of_scipy_on_a_uniform_grid():
    rng = np.random.default_rng(0)
    time_s = 0.02 * np.arange(300)
    values = np.cumsum(rng.normal(size=(300, 2)), axis=0)
    smooth = ZeroPhaseSmoother(window_s=0.9)(time_s, values, time_s)
    np.testing.assert_allclose(smooth.value, savgol_filter(values, 45, 2, axis=0), atol=1e-9)


@pytest.mark.parametrize("smoother", SMOOTHERS[:2], ids=repr)
@pytest.mark.parametrize("gap_s", [1e-4, 1e-7, 1e-12])
def test_samples_that_nearly_coincide_do_not_make_the_track_swing(smoother, gap_s):
    """Two sources with one clock: each tenth position comes twice, with noise of 5 cm."""
    rng, once = np.random.default_rng(0), np.arange(0.0, 10.0, 0.08)
    time_s = np.sort(np.concatenate([once, once[5::10] + gap_s]))
    measured = 5.0 * time_s + rng.normal(0.0, 0.05, len(time_s))
    at_s = np.arange(1.0, 9.0, 0.1)
    smooth = smoother(time_s, measured[:, None], at_s)
    assert np.abs(smooth.value[:, 0] - 5.0 * at_s).max() < 0.1
    assert np.abs(smooth.rate[:, 0] - 5.0).max() < 0.5


def test_zero_phase_commutes_with_reversing_time():
    rng = np.random.default_rng(1)
    time_s, values = irregular(rng), rng.normal(size=(120, 1))
    at_s = np.linspace(time_s[0], time_s[-1], 30)
    forward = ZeroPhaseSmoother()(time_s, values, at_s).value
    backward = ZeroPhaseSmoother()(-time_s[::-1], values[::-1], -at_s[::-1]).value[::-1]
    np.testing.assert_allclose(forward, backward, atol=1e-9)


@pytest.mark.parametrize(
    "smoother", [CausalSmoother(), CausalSmoother(order=1), Unsmoothed()], ids=repr
)
def test_causal_values_do_not_change_with_later_samples(smoother):
    rng = np.random.default_rng(2)
    time_s, values = irregular(rng), rng.normal(size=(120, 2))
    at_s = np.array([time_s[60], 0.5 * (time_s[60] + time_s[61])])
    before = smoother(time_s[:61], values[:61], at_s)
    disturbed = values.copy()
    disturbed[61:] += 1e3
    np.testing.assert_array_equal(before, smoother(time_s, disturbed, at_s))


@pytest.mark.parametrize("smoother", [CausalSmoother(), Unsmoothed()], ids=str)
def test_samples_at_rows_stay_there_on_a_clock_since_1970(smoother):
    at_s = np.round(0.1 * np.arange(200), 1)
    clock_s = (1.7e9 + at_s) - 1.7e9
    assert (clock_s != at_s).any()
    weave = np.sin(2.0 * np.pi * at_s)[:, None]
    expected = smoother(at_s, weave, at_s).value
    np.testing.assert_allclose(smoother(clock_s, weave, at_s).value, expected, atol=1e-5)


def test_zero_phase_looks_no_further_than_it_says():
    rng = np.random.default_rng(3)
    smoother = ZeroPhaseSmoother()
    time_s, values = 0.04 * np.arange(300), rng.normal(size=(300, 1))
    disturbed = values.copy()
    disturbed[time_s > 6.0 + smoother.lookahead_s + 0.5] += 1.0
    at_s = np.array([6.0])
    before, after = smoother(time_s, values, at_s), smoother(time_s, disturbed, at_s)
    np.testing.assert_allclose(before.value, after.value, atol=1e-4)


@pytest.mark.parametrize("window_s", [0.6, 0.9, 1.5])
@pytest.mark.parametrize(("beyond_s", "seen"), [(-0.15, True), (0.15, False)])
def test_zero_phase_looks_half_a_window_ahead(window_s, beyond_s, seen) -> None:
    smoother, time_s = ZeroPhaseSmoother(window_s), 0.02 * np.arange(500)
    later = (time_s > 5.0 + smoother.lookahead_s + beyond_s).astype(float)[:, None]
    assert smoother.lookahead_s == pytest.approx(window_s / 2)
    assert (abs(smoother(time_s, later, np.array([5.0])).value.item()) > 1e-3) is seen


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("step_s", [0.002, 0.01, 0.02])
def test_a_series_shorter_than_the_grid_comes_back_exactly(order, step_s) -> None:
    time_s = step_s * np.arange(ZeroPhaseSmoother.samples_needed)
    smooth = ZeroPhaseSmoother(order=order)(time_s, (2.0 - 3.0 * time_s)[:, None], time_s)
    np.testing.assert_allclose(smooth.value[:, 0], 2.0 - 3.0 * time_s, atol=1e-9)
    np.testing.assert_allclose(smooth.rate, -3.0, atol=1e-6)


@pytest.mark.parametrize("window_s", [0.8, 1.2])
@pytest.mark.parametrize("begin_s", [0.0, 3.5])
def test_nothing_is_put_out_in_the_first_half_window(window_s, begin_s) -> None:
    smoother, time_s = CausalSmoother(window_s), begin_s + 0.1 * np.arange(40)
    known = np.isfinite(smoother(time_s, time_s[:, None], time_s).value[:, 0])
    assert time_s[known][0] == pytest.approx(begin_s + window_s / 2)
    assert known.sum() == 40 - round(5 * window_s)


@pytest.mark.parametrize(
    ("smoother", "left"), [(ZeroPhaseSmoother(), 0.6), (CausalSmoother(), 0.9)]
)
def test_smoothing_removes_white_noise(smoother, left):
    rng = np.random.default_rng(4)
    time_s = 0.08 * np.arange(400)
    noise = rng.normal(0.0, 0.08, (400, 1))
    assert smoother(time_s, noise, time_s[30:-30]).value.std() < left * 0.08


@pytest.mark.parametrize(
    "options", [{"window_s": 0.0}, {"window_s": -1.0}, {"order": 0}, {"order": 4}]
)
def test_impossible_settings_are_refused(options):
    with pytest.raises(ConversionError, match=next(iter(options))):
        ZeroPhaseSmoother(**options)


@pytest.mark.parametrize(
    ("time_s", "samples", "after_s", "expected"),
    [
        (
            [0.0, 0.4, 0.8, 1.2],
            [0.0, 1.0, 3.0, 6.0],
            [1.4],
            ([0.0, 1.0, 3.0, 6.0, 7.5], [0.0, 2.5, 5.0, 7.5, 7.5], [0.0, 0.0, 6.25, 6.25, 6.25]),
        ),
        (
            [0.0, 1.0, 3.0, 4.0],
            [0.0, 1.0, 5.0, 8.0],
            [],
            ([0.0, 1.0, 5.0, 8.0], [0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.5, 1.0]),
        ),
    ],
    ids=["equal steps and one after the last", "a longer step"],
)
def test_unsmoothed_samples_have_backward_differences(time_s, samples, after_s, expected):
    column = np.array(samples)[:, None]
    smooth = Unsmoothed()(np.array(time_s), column, np.array([*time_s, *after_s]))
    for found, wanted in zip((smooth.value, smooth.rate, smooth.curvature), expected, strict=True):
        np.testing.assert_allclose(found[:, 0], wanted)


@pytest.mark.parametrize("apart_s", [1e-3, 0.01, 0.02, 0.05])
def test_samples_that_come_in_pairs_do_not_make_velocities_explode(apart_s):
    single = np.arange(0.0, 30.0, 0.5)
    time_s = np.sort(np.concatenate([single, single + apart_s]))
    noise = np.random.default_rng(0).normal(0.0, 0.05, len(time_s))
    smoother, at_s = CausalSmoother(), np.arange(2.0, 29.0, 0.1)
    paired = smoother(time_s, (4.0 * time_s + noise)[:, None], at_s)
    alone = smoother(single, (4.0 * single + noise[::2])[:, None], at_s)
    assert np.std(paired.rate) < 1.5 * np.std(alone.rate)


@pytest.mark.parametrize("step_s", [0.01, 0.04, 0.08, 0.1, 0.4, 0.5])
def test_regular_samples_are_fitted_over_the_window_or_the_last_four(step_s):
    time_s = step_s * np.arange(200)
    values = np.random.default_rng(0).normal(size=(200, 1))
    first = min(np.searchsorted(time_s, time_s[150] - 1.2 + 1e-9), 150 - 3)
    used = slice(first, 151)
    fit = np.polynomial.Polynomial.fit(time_s[used], values[used, 0], 2)
    found = CausalSmoother()(time_s, values, time_s[150:151])
    np.testing.assert_allclose(found.value[0, 0], fit(time_s[150]), atol=1e-9)
