"""Navigation scores against plain loops over hand-made episodes."""

import math

import pytest
import torch

from diffstack_mmv.metrics.navigation import (
    CollisionRate,
    DiscomfortDistance,
    DiscomfortFrequency,
    EpisodeMinimumDistance,
    IncompleteRate,
    NavigationTime,
    NavigationTimeOfAll,
    RideAcceleration,
    RideJerk,
    SuccessRate,
    ride,
    uneasy_steps,
    wilson_interval,
)
from diffstack_mmv.types import EpisodeRecord, Motion, Outcome

ENDINGS = torch.tensor([3, 2, 4, 3, 2, 3])
METRICS = [
    SuccessRate,
    CollisionRate,
    IncompleteRate,
    NavigationTime,
    NavigationTimeOfAll,
    DiscomfortFrequency,
    DiscomfortDistance,
    EpisodeMinimumDistance,
    RideAcceleration,
    RideJerk,
]


def record_of(outcome=ENDINGS, steps=None, clearance=None, dt_s=0.25):
    """Episodes of at most eight steps that end with the given outcomes."""
    count = len(outcome)
    generator = torch.Generator().manual_seed(7)
    steps = torch.randint(3, 9, (count,), generator=generator) if steps is None else steps
    if clearance is None:
        clearance = torch.rand(count, 9, generator=generator, dtype=torch.float64) - 0.1
    rows = torch.zeros(count, 9, dtype=torch.float64)
    pair = rows[..., None].expand(count, 9, 2)
    limit = torch.full((count,), 8 * dt_s, dtype=torch.float64)
    return EpisodeRecord(
        motion=Motion(pair, rows, pair, rows),
        pedestrians=pair[:, :, None],
        controls=pair[:, 1:],
        reward=rows[:, 1:],
        clearance=clearance,
        outcome=outcome,
        steps=steps,
        duration=torch.where(outcome == Outcome.TIMEOUT, limit, steps * dt_s),
        dt_s=dt_s,
    )


def score(metric, *records):
    instance = metric()
    for record in records:
        instance.update(record)
    return float(instance.compute())


@pytest.mark.parametrize(
    ("metric", "expected"), [(SuccessRate, 3 / 6), (CollisionRate, 2 / 6), (IncompleteRate, 1 / 6)]
)
def test_rates_count_the_outcomes(metric, expected):
    assert score(metric, record_of()) == pytest.approx(expected)


def test_times_are_means_of_successes_and_of_all():
    record = record_of(steps=torch.tensor([4, 5, 8, 6, 7, 8]))
    assert score(NavigationTime, record) == pytest.approx((4 + 6 + 8) * 0.25 / 3)
    assert score(NavigationTimeOfAll, record) == pytest.approx((4 + 5 + 8 + 6 + 7 + 8) * 0.25 / 6)


def test_discomfort_equals_a_plain_loop():
    record, distances, steps = record_of(), [], 0.0
    for episode, clearance in enumerate(record.clearance):
        end = int(record.steps[episode])
        distances += [float(d) for d in clearance[1:end] if 0 <= d < 0.2]
        steps += float(record.duration[episode]) / record.dt_s
    assert len(distances) > 2
    assert score(DiscomfortFrequency, record) == pytest.approx(len(distances) / steps)
    assert score(DiscomfortDistance, record) == pytest.approx(sum(distances) / len(distances))


def test_the_smallest_distance_of_an_episode_is_at_least_zero():
    clearance = torch.full((2, 9), 0.5, dtype=torch.float64)
    clearance[0, 4] = -0.3
    record = record_of(torch.tensor([2, 3]), clearance=clearance)
    assert score(EpisodeMinimumDistance, record) == pytest.approx(0.25)
    clearance[1] = torch.inf  # nobody is there
    assert score(EpisodeMinimumDistance, record) == 0.0
    assert math.isnan(
        score(EpisodeMinimumDistance, record_of(torch.tensor([3]), clearance=clearance[1:]))
    )


def test_start_and_end_of_an_episode_are_no_uneasy_steps():
    near = torch.full((1, 9), 0.1, dtype=torch.float64)
    record = record_of(torch.tensor([3]), steps=torch.tensor([4]), clearance=near)
    assert uneasy_steps(record)[0].tolist() == [False, True, True, True] + 5 * [False]


@pytest.mark.parametrize(
    ("clearance", "uneasy"), [(-0.01, False), (0.0, True), (0.19, True), (0.2, False)]
)
def test_a_step_is_uneasy_from_touching_on_and_below_a_fifth_of_a_metre(clearance, uneasy):
    near = torch.full((1, 9), clearance, dtype=torch.float64)
    record = record_of(torch.tensor([3]), steps=torch.tensor([4]), clearance=near)
    assert bool(uneasy_steps(record)[0, 2]) is uneasy


def test_without_cases_an_interval_is_unknown():
    none = torch.zeros(())
    assert all(end.isnan() for end in wilson_interval(none, none))


@pytest.mark.parametrize("metric", METRICS)
def test_records_in_parts_score_like_the_whole(metric):
    whole = record_of()
    parts = [
        EpisodeRecord(
            Motion(*(field[rows] for field in whole.motion)),
            *(field[rows] for field in whole[1:-1]),
            whole.dt_s,
        )
        for rows in (slice(0, 2), slice(2, 6))
    ]
    assert score(metric, *parts) == pytest.approx(score(metric, whole))


@pytest.mark.parametrize("metric", METRICS)
def test_states_of_two_processes_add_up(metric):
    one, two, both = metric(), metric(), metric()
    records = record_of(), record_of(torch.tensor([2, 4, 3]))
    for part, record in zip((one, two), records, strict=True):
        part.update(record)
        both.update(record)
    one.merge_state(two)
    assert float(one.compute()) == pytest.approx(float(both.compute()))


def test_another_score_is_not_merged():
    with pytest.raises(ValueError, match="`other` must be a SuccessRate, but got CollisionRate"):
        SuccessRate().merge_state(CollisionRate())


@pytest.mark.parametrize("metric", [NavigationTime, DiscomfortDistance])
def test_a_mean_over_nothing_is_not_a_number(metric):
    far = torch.full((1, 9), 3.0, dtype=torch.float64)
    assert math.isnan(score(metric, record_of(torch.tensor([2]), clearance=far)))


def test_episodes_that_still_run_are_refused():
    with pytest.raises(ValueError, match="`record` must hold ended episodes only, but got 1"):
        SuccessRate().update(record_of(torch.tensor([3, 0])))


@pytest.mark.parametrize(
    ("hits", "total", "low", "high"),
    [(5, 10, 0.2366, 0.7634), (0, 100, 0.0, 0.0370), (100, 100, 0.9630, 1.0)],
)
def test_wilson_intervals_have_the_known_ends(hits, total, low, high):
    interval = wilson_interval(torch.tensor(float(hits)), torch.tensor(float(total)))
    assert float(interval.low) == pytest.approx(low, abs=1e-4)
    assert float(interval.high) == pytest.approx(high, abs=1e-4)


@pytest.mark.parametrize("total", [1.0, 3.0, 7.0, 500.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_intervals_of_none_and_all_end_at_zero_and_one(total, dtype):
    cases = torch.tensor([0.0, total], dtype=dtype)
    interval = wilson_interval(cases, torch.full_like(cases, total))
    assert interval.low[0] == 0 < interval.low[1]
    assert interval.high[0] < 1 == interval.high[1]


def test_a_rate_comes_with_the_interval_around_it():
    metric = SuccessRate()
    metric.update(record_of())
    interval = metric.interval()
    assert interval.low < metric.compute() < interval.high


def test_a_quantile_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="`quantile` must be positive"):
        wilson_interval(torch.tensor(1.0), torch.tensor(2.0), quantile=0.0)


def test_a_ride_is_as_rough_as_its_changes_of_velocity():
    record = record_of(steps=torch.tensor([4, 8, 8, 8, 8, 8]))
    time = 0.25 * torch.arange(9, dtype=torch.float64)
    turning = torch.stack((torch.full_like(time, 2.0), torch.zeros_like(time)), -1)
    motion = record.motion._replace(
        velocity=record.motion.velocity.clone(), heading=record.motion.heading.clone()
    )
    motion.velocity[0, :, 0] = 3 * time  # 3 m/s² straight on
    motion.velocity[0, 5:] = 100.0  # after the end
    motion.velocity[1], motion.heading[1] = turning, 0.4 * time  # a bend at 2 m/s and 0.4 rad/s
    rough = ride(record._replace(motion=motion))
    assert rough.acceleration[:3].tolist() == pytest.approx([3.0, 0.8, 0.0], abs=1e-3)
    assert rough.jerk[:3].tolist() == pytest.approx([0.0, 0.32, 0.0], abs=1e-3)


def test_a_ride_of_one_step_has_an_acceleration_and_no_jerk():
    record = record_of(torch.tensor([3]), steps=torch.tensor([1]))
    velocity = record.motion.velocity.clone()
    velocity[0, 1, 0] = 0.5
    rough = ride(record._replace(motion=record.motion._replace(velocity=velocity)))
    assert (float(rough.acceleration), float(rough.jerk)) == (2.0, 0.0)
