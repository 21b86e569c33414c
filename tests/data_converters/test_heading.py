"""Heading: along the motion, held at rest, along the cuboid."""

import numpy as np
import pytest

from data_converters import CausalSmoother, ResampleSettings, ZeroPhaseSmoother
from data_converters.heading import (
    HeadingSource,
    heading_from_axis,
    heading_from_motion,
    heading_measured,
    wrap,
)
from data_converters.imptc.cuboid import measure_cuboids
from data_converters.imptc.sample.sensor import cuboid_edges
from data_converters.resampling import resample
from data_converters.two_wheeler.reader import lean_to_the_left

STANDSTILL = 0.4
TIMES = 0.1 * np.arange(40)


def velocity(speeds, angle):
    return np.asarray(speeds)[:, None] * np.array([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi / 2, -2.5, 3.1])
def test_heading_is_held_while_the_agent_stands(angle):
    moving, still = velocity([2.0, 2.0], angle), velocity([0.1, 0.1], angle + 2.0)
    heading = heading_from_motion(np.vstack([moving, still]), STANDSTILL, backfill=True)
    np.testing.assert_allclose(heading.angle, angle)
    assert heading.source.tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("last_mps", "backfill", "angle", "source"),
    [
        (1.0, True, [0.7, 0.7, 0.7], [2, 2, 0]),
        (1.0, False, [0.0, 0.0, 0.7], [3, 3, 0]),
        (0.2, True, [0.0, 0.0, 0.0], [3, 3, 3]),
        (0.2, False, [0.0, 0.0, 0.0], [3, 3, 3]),
    ],
    ids=["backfilled", "nothing of the future", "never moves", "never moves, not backfilled"],
)
def test_heading_before_the_first_motion_is_taken_from_it_only_on_demand(
    last_mps, backfill, angle, source
):
    track = np.vstack([velocity([0.0, 0.1], 2.0), velocity([last_mps], 0.7)])
    heading = heading_from_motion(track, STANDSTILL, backfill=backfill)
    np.testing.assert_allclose(heading.angle, angle)
    assert heading.source.tolist() == source


def test_noise_at_standstill_does_not_turn_a_resampled_agent(make_track):
    rng = np.random.default_rng(0)
    track = make_track(
        0.08 * np.arange(200),
        lambda t: np.where(t < 8.0, 3.0 * t, 24.0) + rng.normal(0, 0.03, len(t)),
        lambda t: rng.normal(0, 0.03, len(t)),
    )
    heading = resample(track, ResampleSettings()).rows.heading.to_numpy()
    assert np.ptp(heading[95:]) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("course", [*np.linspace(-3.0, 3.0, 7), np.pi / 2])
@pytest.mark.parametrize("turned", [False, True])
def test_a_cuboid_axis_takes_the_sign_of_the_motion(course, turned):
    time_s = 0.04 * np.arange(100)
    axis = np.full(100, course + np.pi * turned) % np.pi
    at_s = np.arange(0.1, 3.9, 0.1)
    moved = velocity(np.full(len(at_s), 5.0), course)
    heading = heading_from_axis(axis, time_s, at_s, moved, ZeroPhaseSmoother(), STANDSTILL)
    np.testing.assert_allclose(wrap(heading.angle - course), 0.0, atol=1e-9)


@pytest.mark.parametrize("course", [-2.5, -0.4, 0.1, 1.5, 3.1])
@pytest.mark.parametrize("drift", [-1.4, -0.5, 0.5, 1.4])
def test_a_body_that_drifts_faces_the_nearer_end_of_its_axis(course, drift) -> None:
    moved = velocity(np.full(len(TIMES), 2.0), course + drift)
    axis = np.full(len(TIMES), course) % np.pi
    heading = heading_from_axis(axis, TIMES, TIMES, moved, ZeroPhaseSmoother(), STANDSTILL)
    np.testing.assert_allclose(wrap(heading.angle - course), 0.0, atol=1e-9)


@pytest.mark.parametrize("smoother", [CausalSmoother(), ZeroPhaseSmoother()], ids=repr)
@pytest.mark.parametrize(("start", "rate"), [(-2.0, 0.0), (3.0, 0.3), (-3.0, -0.3), (0.5, 0.3)])
def test_a_recorded_heading_is_followed_across_the_seam(smoother, start, rate) -> None:
    recorded, at_s = start + rate * TIMES, TIMES[10:]
    heading = heading_measured(wrap(recorded), TIMES, at_s, smoother)
    np.testing.assert_allclose(wrap(heading.angle - recorded[10:]), 0.0, atol=2e-3)
    assert (np.abs(heading.angle) <= np.pi).all()
    assert set(heading.source) == {HeadingSource.MEASURED}


def test_a_turning_cuboid_is_followed_through_half_turns():
    time_s = 0.04 * np.arange(250)
    course = 0.6 * time_s
    at_s = np.arange(0.5, 9.0, 0.1)
    moved = 5.0 * np.column_stack([np.cos(0.6 * at_s), np.sin(0.6 * at_s)])
    heading = heading_from_axis(
        course % np.pi, time_s, at_s, moved, ZeroPhaseSmoother(), STANDSTILL
    )
    np.testing.assert_allclose(wrap(heading.angle - 0.6 * at_s), 0.0, atol=1e-6)


def test_a_parked_car_keeps_its_axis_and_says_that_the_sign_is_unknown():
    time_s = 0.04 * np.arange(100)
    still = np.zeros((20, 2))
    heading = heading_from_axis(
        np.full(100, 1.2), time_s, np.linspace(0.1, 3.0, 20), still, ZeroPhaseSmoother(), STANDSTILL
    )
    np.testing.assert_allclose(heading.angle % np.pi, 1.2)
    assert set(heading.source) == {HeadingSource.UNKNOWN}


def test_without_look_ahead_the_sign_is_that_of_the_motion_so_far():
    time_s, at_s = 0.04 * np.arange(200), np.arange(2.0, 7.0, 0.1)
    speed = np.where(at_s < 3.0, 0.0, np.where(at_s < 4.0, 2.0, -5.0))
    sign = [
        heading_from_axis(
            np.full(200, 0.5), time_s, at_s, velocity(speed, 0.5), smoother, STANDSTILL
        )
        for smoother in (CausalSmoother(), ZeroPhaseSmoother())
    ]
    # it backs out over a longer distance than it came in, which only hindsight knows at first
    np.testing.assert_allclose(wrap(sign[0].angle[:20] - 0.5), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(wrap(sign[1].angle - 0.5)), np.pi, atol=1e-9)
    assert set(sign[0].source[:10]) == {HeadingSource.UNKNOWN}


@pytest.mark.parametrize("smoother", [CausalSmoother(), ZeroPhaseSmoother()], ids=repr)
def test_what_drifts_at_standstill_does_not_count_for_the_sign(smoother):
    time_s, at_s = 0.04 * np.arange(300), np.arange(2.0, 11.0, 0.1)
    speed = np.where(at_s < 3.0, 2.0, -0.35)  # back again and farther, but as slow as noise
    heading = heading_from_axis(
        np.full(300, 0.5), time_s, at_s, velocity(speed, 0.5), smoother, STANDSTILL
    )
    np.testing.assert_allclose(wrap(heading.angle - 0.5), 0.0, atol=1e-9)
    assert set(heading.source) == {HeadingSource.MEASURED}


DIRECTED = {
    "motion": lambda: heading_from_motion(np.ones((40, 3))[:, :2], STANDSTILL, backfill=False),
    "axis": lambda: heading_from_axis(
        np.ones(40), TIMES, TIMES, np.ones((40, 2)), CausalSmoother(), STANDSTILL
    ),
    "measured": lambda: heading_measured(np.ones(40), TIMES, TIMES, CausalSmoother()),
    "cuboid": lambda: measure_cuboids(
        [cuboid_edges(np.zeros(3), 0.3, (4.0, 2.0, 1.5)).tolist()] * 3, "here"
    ),
    "lean": lambda: lean_to_the_left(np.ones((40, 3)), np.ones((40, 2))),
}


@pytest.mark.parametrize("kind", DIRECTED)
def test_directions_do_not_depend_on_where_memory_happens_to_lie(kind, monkeypatch):
    # numpy's loops differ in the last bits, and between columns with gaps it takes the slower one
    # if the result lies right behind them: two conversions of the same recordings differed
    arctan2, without_gaps = np.arctan2, []

    def noted(*columns):
        without_gaps.extend(column.flags.c_contiguous for column in columns)
        return arctan2(*columns)

    monkeypatch.setattr(np, "arctan2", noted)
    DIRECTED[kind]()
    assert without_gaps == [True, True]
