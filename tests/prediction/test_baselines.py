"""Predictors that learn nothing."""

import numpy as np
import pytest
import torch
from scipy.integrate import trapezoid

from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.prediction import (
    ConstantTurnRateAcceleration,
    ConstantVelocity,
    GroundTruth,
    KalmanConstantVelocity,
    NoPrediction,
    Spread,
    StandStill,
    ego_forecast,
    neighbors_forecast,
)
from diffstack_mmv.types import Motion
from tests.prediction.samples import DT_S, scene

MOVING = [ConstantVelocity, ConstantTurnRateAcceleration, KalmanConstantVelocity]


def straight(batch, acceleration=0.0, history=41, horizon=10):
    """Put the ego of a scene on a straight line along x with a constant acceleration in m/s²."""
    time = DT_S * torch.arange(1 - history, horizon + 1)
    speed = (4 + acceleration * time).expand(*batch.goal.shape[:-1], -1)
    x = (4 * time + 0.5 * acceleration * time**2).expand_as(speed)
    zero = torch.zeros_like(x)
    line = Motion(torch.stack([x, zero], -1), zero, torch.stack([speed, zero], -1), zero)
    past = Motion(*(field[:, :history] for field in line))
    future = Motion(*(field[:, history:] for field in line))
    return batch._replace(
        ego_past=batch.ego_past._replace(motion=past),
        ego_future=batch.ego_future._replace(motion=future),
    )


@pytest.mark.parametrize("predictor", MOVING)
def test_uniform_motion_is_continued_exactly(predictor):
    batch = straight(scene(history=41))
    mean = ego_forecast(predictor(10, DT_S).predict(batch)).mean[:, 0]
    assert torch.allclose(mean, batch.ego_future.motion.position, atol=2e-2)


def test_stand_still_stays_at_the_last_position():
    batch = scene()
    mean = ego_forecast(StandStill(10, DT_S).predict(batch)).mean[:, 0]
    assert torch.allclose(mean, batch.ego_past.motion.position[:, -1:].expand_as(mean))


@pytest.mark.parametrize(
    ("make", "settings", "off_m"),
    [
        (
            lambda: straight(scene(history=41), acceleration=-0.5),
            {"acceleration_fade_s": 1e4},
            1e-2,
        ),
        (
            lambda: scene(neighbors=0, history=41),
            {"memory_s": 0.3, "yaw_rate_fade_s": 1e4, "walking_mps": 1e-3},
            0.1,
        ),
    ],
    ids=["an acceleration", "a circle"],
)
def test_unfading_ctra_continues_what_was_begun(make, settings, off_m):
    batch, predictor = make(), ConstantTurnRateAcceleration(10, DT_S, **settings)
    mean = ego_forecast(predictor.predict(batch)).mean[:, 0]
    assert torch.allclose(mean, batch.ego_future.motion.position, atol=off_m)


def test_ctra_stops_and_does_not_reverse():
    batch = straight(scene(history=41, horizon=60), acceleration=-3.0, horizon=60)
    predictor = ConstantTurnRateAcceleration(60, DT_S, acceleration_fade_s=1e4)
    x = ego_forecast(predictor.predict(batch)).mean[:, 0, :, 0]
    assert (x.diff(dim=-1) >= 0).all()
    assert (x[:, -1] - x[:, -20]).abs().max() == 0


def test_constant_velocity_uses_the_rows_there_are():
    batch = scene(history=41)
    valid = torch.zeros_like(batch.ego_past.valid)
    valid[:, -1] = True
    only_last = batch._replace(ego_past=batch.ego_past._replace(valid=valid))
    mean = ego_forecast(ConstantVelocity(10, DT_S).predict(only_last)).mean[:, 0]
    speed = (mean[:, 1] - mean[:, 0]).norm(dim=-1) / DT_S
    assert torch.allclose(speed, batch.ego_past.motion.velocity[:, -1, 0], atol=1e-4)


def test_ground_truth_answers_with_the_future():
    batch = scene()
    forecast = GroundTruth(10, DT_S).predict(batch)
    assert torch.equal(ego_forecast(forecast).mean[:, 0], batch.ego_future.motion.position)
    assert torch.equal(
        neighbors_forecast(forecast).mean[:, :, 0], batch.neighbors_future.motion.position
    )


def test_ground_truth_holds_the_last_known_position():
    batch = scene()
    valid = batch.ego_future.valid.clone()
    valid[:, 4:] = False
    short = batch._replace(ego_future=batch.ego_future._replace(valid=valid))
    mean = ego_forecast(GroundTruth(10, DT_S).predict(short)).mean[:, 0]
    assert torch.equal(mean[:, 4:], mean[:, 3:4].expand_as(mean[:, 4:]))


def test_ground_truth_refuses_a_past_alone():
    batch = scene()
    with pytest.raises(TypeError, match="Call `predict` with a whole batch"):
        GroundTruth(10, DT_S)(batch.ego_past, batch.neighbors_past)


def test_no_prediction_sends_neighbors_away_and_leaves_the_ego():
    batch = scene()
    forecast = NoPrediction(10, DT_S).predict(batch)
    assert neighbors_forecast(forecast).mean.abs().min() > 1e3
    assert torch.equal(
        ego_forecast(forecast).mean, ego_forecast(ConstantVelocity(10, DT_S).predict(batch)).mean
    )


def test_spread_grows_with_time_and_speed():
    time = torch.tensor([0.5, 1.0, 2.0])
    scale = Spread().scale_tril(torch.zeros(2), torch.tensor([0.0, 5.0]), time)[..., 0, 0]
    assert (scale.diff(dim=-1) > 0).all()
    assert (scale[1] > scale[0]).all()


@pytest.mark.parametrize("course", [0.0, 0.9, -2.4])
def test_spread_is_that_of_an_unknown_acceleration_along_and_across_the_course(course):
    spread = Spread(position_m=0.2, rest_mps2=0.3, along_per_s=0.4, across_per_s=0.1)
    scale = spread.scale_tril(torch.tensor([course]), torch.tensor([5.0]), torch.tensor([0.5, 2.0]))
    turn = np.array([[np.cos(course), -np.sin(course)], [np.sin(course), np.cos(course)]])
    for root, time in zip(scale[0].double().numpy(), (0.5, 2.0), strict=True):
        along, across = (0.3 + gain * 5.0 for gain in (0.4, 0.1))
        variance = [0.2**2 + (0.5 * unknown * time**2) ** 2 for unknown in (along, across)]
        expected = turn @ np.diag(variance) @ turn.T + 4e-4 * np.eye(2)
        np.testing.assert_allclose(root @ root.T, expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("predictor", [StandStill, ConstantVelocity])
def test_a_forecast_spreads_by_the_heading_and_the_way_of_the_last_half_second(predictor):
    batch = straight(scene(neighbors=1), acceleration=2.0, history=21)
    forecast = predictor(10, DT_S).predict(batch)
    mean_speed = (4 * 0.5 - 0.5 * 2.0 * 0.5**2) / 0.5
    time = DT_S * torch.arange(1, 11)
    expected = Spread().scale_tril(torch.zeros(1), torch.tensor([mean_speed]), time)
    torch.testing.assert_close(ego_forecast(forecast).scale_tril[:1, 0], expected)


@pytest.mark.parametrize("options", [{"rest_mps2": 0.0}, {"across_per_s": -1.0}])
def test_an_impossible_spread_is_refused(options):
    with pytest.raises(ValueError, match=f"`{next(iter(options))}` must be positive"):
        Spread(**options)


@pytest.mark.parametrize("options", [{"window_s": 0.0}, {"window_s": -1.0}])
def test_impossible_window_is_refused(options):
    with pytest.raises(ValueError, match="`window_s` must be positive"):
        ConstantVelocity(10, DT_S, **options)


@pytest.mark.parametrize(("forward", "leftward"), [(0.8, -0.6), (-0.4, 0.9), (9.0, 30.0)])
def test_ctra_fades_what_it_measured_within_its_limits(forward, leftward):
    """The integral of v₀ + a₀ τ (1 - exp(-t/τ)) along the course that fades likewise."""
    rows, course, speed = 41, 0.7, 4.0
    batch = straight(scene(batch=(1,), neighbors=0, history=rows), history=rows)
    axes = np.array([[np.cos(course), np.sin(course)], [-np.sin(course), np.cos(course)]])
    way = DT_S * np.arange(1 - rows, 1)[:, None]
    position = speed * way * axes[0] + way**2 / 2 * (forward * axes[0] + leftward * axes[1])
    motion = batch.ego_past.motion._replace(
        position=torch.tensor(position, dtype=torch.float32)[None],
        heading=torch.full((1, rows), course),
    )
    batch = batch._replace(ego_past=batch.ego_past._replace(motion=motion))
    found = ego_forecast(ConstantTurnRateAcceleration(10, DT_S).predict(batch)).mean[0, 0, -1]
    faster = np.clip(forward, -3.0, 3.0)
    turning = np.clip(leftward * speed / (speed**2 + 0.5**2), -1.0, 1.0)

    def velocity(time):
        faded = 0.3 * (1 - np.exp(-time / 0.3))
        angle = course + turning * faded
        return (speed + faster * faded) * np.array([np.cos(angle), np.sin(angle)])

    time = np.linspace(0, 1.0, 2001)
    expected = trapezoid(velocity(time), time, axis=-1)
    np.testing.assert_allclose(found.numpy(), expected, atol=6e-3)


@pytest.mark.parametrize("walking", [0.5, 3.0])
def test_ctra_turns_less_where_the_course_is_less_sure(walking):
    """By v² / (v² + w²) of the turn that a sure course shows."""
    batch = scene(neighbors=0, history=41)
    settings = {"memory_s": 0.3, "yaw_rate_fade_s": 1e4, "acceleration_fade_s": 1e-3}

    def turned(walking_mps):
        predictor = ConstantTurnRateAcceleration(2, DT_S, walking_mps=walking_mps, **settings)
        step = ego_forecast(predictor.predict(batch)).mean[:, 0].diff(dim=1)[:, 0]
        return torch.atan2(step[:, 1], step[:, 0]), step.norm(dim=-1) / DT_S

    (sure, speed), (unsure, _), (straight_on, _) = map(turned, (1e-3, walking, 1e4))
    share = wrap_angle(unsure - straight_on) / wrap_angle(sure - straight_on)
    assert torch.allclose(share, speed**2 / (speed**2 + walking**2), atol=0.02)
