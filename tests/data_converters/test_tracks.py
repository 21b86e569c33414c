"""Splitting, resampling and the columns of a row."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_converters import (
    CausalSmoother,
    ConversionError,
    Mode,
    RejectReason,
    ResampleSettings,
    Sampling,
    TrackError,
    Unsmoothed,
    ZeroPhaseSmoother,
    default_extent,
)
from data_converters.resampling import resample
from data_converters.tracks import split_at_gaps

SETTINGS = ResampleSettings(smoother=ZeroPhaseSmoother())


@given(
    st.sampled_from([0.02, 0.04, 0.08]),
    st.floats(0.5, 12.0),
    st.floats(-3.0, 3.0),
    st.floats(0.0, 0.1),
    st.integers(0, 99),
)
def test_resampled_rows_lie_on_the_true_track(make_track, step, speed, acceleration, start, seed):
    jitter = np.random.default_rng(seed).uniform(-0.3, 0.3, 200) * step
    time_s = start + step * np.arange(1, 201) + jitter
    track = make_track(time_s, lambda t: speed * t + 0.5 * acceleration * t**2, lambda t: 1.0 - t)
    agent = resample(track, SETTINGS)
    at_s = (agent.first_step + np.arange(len(agent.rows))) * SETTINGS.dt_s
    expected = speed * at_s + 0.5 * acceleration * at_s**2
    np.testing.assert_allclose(agent.rows.x, expected, atol=1e-6)
    np.testing.assert_allclose(agent.rows.vx, speed + acceleration * at_s, atol=1e-4)
    np.testing.assert_allclose(agent.rows.ax, acceleration, atol=1e-2)
    np.testing.assert_allclose(agent.rows.y, 1.0 - at_s, atol=1e-6)
    assert time_s[0] <= at_s[0] + 1e-9
    assert at_s[-1] <= time_s[-1] + 1e-9


def test_rows_cover_every_step_of_the_track(make_track):
    agent = resample(make_track(0.08 * np.arange(100), lambda t: t), SETTINGS)
    assert (agent.first_step, len(agent.rows)) == (0, 80)


def test_sampling_is_told_beside_the_rows_whatever_is_missing(make_track):
    time_s = 0.13 + np.delete(0.04 * np.arange(100), [7, 50, 51])
    agent = resample(make_track(time_s, lambda t: t), ResampleSettings(smoother=CausalSmoother()))
    assert agent.sampling == pytest.approx((0.1 * agent.first_step - 0.13, 0.04))


@pytest.mark.parametrize(
    ("time_s", "step_s"),
    [([0.0, 0.1], 0.1), ([2.0, 2.5, 3.0], 0.5), ([1.0, 1.2, 1.4, 2.0, 2.2], 0.2)],
    ids=["two samples", "three samples", "two of seven missing"],
)
def test_the_usual_step_is_that_of_a_clock_without_gaps(time_s, step_s) -> None:
    found = Sampling.of(np.array(time_s), time_s[0] + 0.05)
    assert found == pytest.approx((0.05, step_s))


@pytest.mark.parametrize(("gap", "parts"), [(0.3, 1), (0.5, 1), (0.52, 2), (2.0, 2)])
def test_only_gaps_longer_than_half_a_second_split_a_track(make_track, gap, parts):
    time_s = np.concatenate([0.04 * np.arange(100), 0.04 * np.arange(100) + 3.96 + gap])
    names = [part.name for part in split_at_gaps(make_track(time_s, lambda t: t), 0.5)]
    assert names == ["agent", "agent_s1"][:parts]


def test_stretches_hold_all_samples_of_a_track_with_all_that_was_measured_of_them(make_track):
    time_s = np.array([0.0, 0.1, 0.2, 2.0, 2.1, 4.0, 4.1, 4.2, 4.3])
    measured = {name: np.arange(9.0) + first for name, first in
                (("axis", 10), ("speed", 20), ("heading", 30))}  # fmt: skip
    track = make_track(time_s, lambda t: 3.0 * t, **measured)
    parts = split_at_gaps(track, 0.5)
    assert [len(part.time_s) for part in parts] == [3, 2, 4]
    for name in ("time_s", "position", *measured):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(track, name))
    bare = split_at_gaps(make_track(time_s, lambda t: t), 0.5)
    assert {(part.axis, part.speed, part.heading) for part in bare} == {(None, None, None)}


def test_a_stretch_takes_no_name_of_another_agent(make_track):
    track = make_track(np.array([0.0, 0.1, 2.0, 2.1, 4.0]), lambda t: t)
    names = [part.name for part in split_at_gaps(track, 0.5, {"agent_s1", "agent_s3"})]
    assert names == ["agent", "agent_s2", "agent_s4"]


@pytest.mark.parametrize(
    ("missing", "marked"), [(slice(50, 60), [20, 21, 22, 23]), (slice(53, 54), [21])]
)
def test_rows_inside_a_gap_are_marked_interpolated(make_track, missing, marked):
    time_s = np.delete(0.04 * np.arange(100), missing)
    rows = resample(make_track(time_s, lambda t: 3.0 * t), SETTINGS).rows
    assert np.flatnonzero(rows.interpolated).tolist() == marked


def test_jitter_of_the_clock_marks_nothing(make_track):
    time_s = 0.04 * np.arange(100) + np.random.default_rng(0).uniform(-0.005, 0.005, 100)
    assert not resample(make_track(time_s, lambda t: t), SETTINGS).rows.interpolated.any()


@pytest.mark.parametrize(
    ("step_s", "count", "settings", "says"),
    [
        (0.04, 1, SETTINGS, "last at least 1 s"),
        (0.04, 3, SETTINGS, "last at least 1 s"),
        (0.04, 20, SETTINGS, "last at least 1 s"),
        (0.45, 3, ResampleSettings(smoother=CausalSmoother()), r"last at least 1\.6 s"),
    ],
)
def test_a_stretch_with_too_few_samples_is_refused(make_track, step_s, count, settings, says):
    with pytest.raises(TrackError, match=says) as caught:
        resample(make_track(step_s * np.arange(count), lambda t: t), settings)
    assert caught.value.reason is RejectReason.TOO_SHORT


@pytest.mark.parametrize(("smoother", "step_s"), [(ZeroPhaseSmoother(), 0.4), (Unsmoothed(), 1.2)])
def test_as_few_samples_as_a_smoother_needs_make_rows(make_track, smoother, step_s) -> None:
    time_s = step_s * np.arange(smoother.samples_needed)
    rows = resample(make_track(time_s, lambda t: 2.0 * t), ResampleSettings(smoother=smoother)).rows
    assert len(rows) == 13
    np.testing.assert_allclose(rows.x.iloc[[0, -1]], [0.0, 2.4], atol=1e-9)


@pytest.mark.parametrize("smoother", [CausalSmoother(), Unsmoothed()], ids=repr)
@pytest.mark.parametrize("step_s", [0.4, 0.5])
def test_a_sparse_track_is_kept_without_look_ahead(make_track, smoother, step_s):
    settings = ResampleSettings(smoother=smoother)
    rows = resample(make_track(step_s * np.arange(20), lambda t: 2.0 * t), settings).rows
    np.testing.assert_allclose(rows.vx[-50:], 2.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(rows.x[-50:]), 0.2, atol=1e-9)


@pytest.mark.parametrize(("window_s", "first"), [(1.2, 6), (0.8, 4), (2.0, 10)])
def test_a_causal_track_starts_after_half_a_window(make_track, window_s, first):
    settings = ResampleSettings(smoother=CausalSmoother(window_s=window_s))
    agent = resample(make_track(0.04 * np.arange(100), lambda t: 2.0 * t), settings)
    assert agent.first_step == first
    np.testing.assert_allclose(agent.rows.vx, 2.0, atol=1e-9)


@pytest.mark.parametrize("course", [0.0, 0.8, np.pi / 2, -2.2])
def test_the_residual_tells_noise_along_from_noise_across(make_track, course):
    rng, time_s = np.random.default_rng(0), 0.04 * np.arange(2000)
    along, across = 4.0 * time_s + rng.normal(0, 0.08, 2000), rng.normal(0, 0.02, 2000)
    cosine, sine = np.cos(course), np.sin(course)
    track = make_track(
        time_s,
        lambda _: cosine * along - sine * across,
        lambda _: sine * along + cosine * across,
    )
    residual = resample(track, SETTINGS).residual
    assert residual.count == 2000
    assert (residual.along / residual.count) ** 0.5 == pytest.approx(0.08, rel=0.1)
    assert (residual.across / residual.count) ** 0.5 == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize(
    ("rate_hz", "share", "smoother"),
    [
        (2, 0.35, ZeroPhaseSmoother()),
        (5, 0.15, ZeroPhaseSmoother()),
        (10, 0.08, ZeroPhaseSmoother()),
        (25, 0.05, ZeroPhaseSmoother()),
        (10, 0.08, CausalSmoother()),
    ],
)
def test_the_noise_is_told_at_any_rate(make_track, rate_hz, share, smoother):
    rng, time_s = np.random.default_rng(1), np.arange(2.0, 142.0, 1.0 / rate_hz)
    noise = rng.normal(0.0, 0.06, (2, len(time_s)))
    track = make_track(
        time_s,
        lambda t: 8.0 * t + np.sin(0.5 * t) + noise[0],
        lambda t: 6.0 * np.sin(0.4 * t) + noise[1],
    )
    found = resample(track, ResampleSettings(smoother=smoother)).residual
    assert (found.along / found.white) ** 0.5 == pytest.approx(0.06, rel=share)
    assert (found.across / found.white) ** 0.5 == pytest.approx(0.06, rel=share)
    assert found.seconds == pytest.approx(found.count / rate_hz)


@pytest.mark.parametrize("smoother", [CausalSmoother(), ZeroPhaseSmoother()], ids=str)
def test_fast_turns_are_not_taken_for_noise(make_track, smoother):
    """The residual of the causal smoother itself told 9 cm."""
    rng, time_s = np.random.default_rng(1), 0.1 * np.arange(600)
    noise = rng.normal(0.0, 0.02, (2, len(time_s)))
    track = make_track(
        time_s,
        lambda t: 5.0 * t + noise[0],
        lambda t: 0.2 * np.sin(2.0 * np.pi * t / 1.5) + noise[1],
    )
    found = resample(track, ResampleSettings(smoother=smoother)).residual
    assert (found.across / found.white) ** 0.5 == pytest.approx(0.02, rel=0.3)


def test_hardly_any_residual_is_left_where_samples_are_sparse(make_track):
    rng = np.random.default_rng(0)
    track = make_track(0.5 * np.arange(200), lambda t: 4.0 * t + rng.normal(0, 0.06, len(t)))
    residual = resample(track, SETTINGS).residual
    assert (residual.along / residual.count) ** 0.5 < 0.01


def test_a_stated_speed_is_only_compared(make_track):
    time_s = 0.04 * np.arange(100)
    plain = resample(make_track(time_s, lambda t: 3.0 * t), SETTINGS)
    stated = resample(make_track(time_s, lambda t: 3.0 * t, speed=np.full(100, 5.0)), SETTINGS)
    assert stated.speed_error == pytest.approx(2.0, abs=1e-6)
    assert plain.rows.equals(stated.rows)


@pytest.mark.parametrize("mode", list(Mode))
def test_every_mode_has_an_extent_longer_than_zero(mode):
    extent = default_extent(mode)
    assert min(extent.length, extent.width, extent.height) > 0.0


@pytest.mark.parametrize("name", ["dt_s", "max_gap_s", "min_duration_s", "standstill_mps"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_settings_that_are_not_positive_are_refused(name, value):
    with pytest.raises(ConversionError, match=name):
        ResampleSettings(**{name: value})
