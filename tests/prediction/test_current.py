"""Estimates of the present motion."""

import math

import numpy as np
import pytest
import torch

from diffstack_mmv.prediction.current import (
    current_course,
    current_heading,
    current_position,
    current_velocity,
    mean_velocity,
    motion_along,
    rest,
    trend,
    trends,
)
from tests.prediction.samples import DT_S, scene


def parabola(rows=21):
    """Velocity (2, 1) and acceleration (0.5, -1) at the last row, poor measured velocities."""
    tracks = scene(batch=(1,), neighbors=0, history=rows, dtype=torch.float64).ego_past
    time = DT_S * torch.arange(1 - rows, 1, dtype=torch.float64).unsqueeze(-1)
    way = time * torch.tensor([2.0, 1.0]) + 0.5 * time**2 * torch.tensor([0.5, -1.0])
    velocity = tracks.motion.velocity * 0
    motion = tracks.motion._replace(position=5.0 + way.unsqueeze(0), velocity=velocity)
    return tracks._replace(motion=motion)


def standing(heading=0.0):
    """A track that ends at the origin."""
    tracks = scene(batch=(1,), neighbors=0).ego_past
    motion = tracks.motion
    stays = motion.position * 0, torch.full_like(motion.heading, heading)
    return tracks._replace(motion=motion._replace(position=stays[0], heading=stays[1]))


def test_trend_finds_velocity_and_acceleration_of_a_parabola():
    now = trend(parabola(), 0.7, DT_S)
    assert torch.allclose(now.velocity, torch.tensor([[2.0, 1.0]], dtype=torch.float64), atol=0.05)
    assert torch.allclose(
        now.acceleration, torch.tensor([[0.5, -1.0]], dtype=torch.float64), atol=0.15
    )


@pytest.mark.parametrize("rows", [1, 2])
def test_trend_of_a_short_track_relies_on_its_measured_velocity(rows):
    tracks = scene(history=21).ego_past
    valid = torch.zeros_like(tracks.valid)
    valid[:, -rows:] = True
    now = trend(tracks._replace(valid=valid), 0.7, DT_S)
    assert torch.allclose(now.velocity, current_velocity(tracks), atol=0.05)
    assert now.acceleration.abs().max() < 2.0


@pytest.mark.parametrize(
    ("missing", "velocity"), [(0, [1.875, 1.25]), (-3, [1.95, 1.1])], ids=["all rows", "three rows"]
)
def test_mean_velocity_is_the_way_over_the_rows_of_the_window(missing, velocity):
    tracks = parabola()
    valid = tracks.valid.clone()
    valid[:, :missing] = False
    now = mean_velocity(tracks._replace(valid=valid), 5, DT_S)
    assert torch.allclose(now, torch.tensor([velocity], dtype=torch.float64))


def test_nobody_moves_who_is_not_observed():
    tracks = scene(history=21).ego_past
    gone = tracks._replace(valid=torch.zeros_like(tracks.valid))
    now = trend(gone, 0.7, DT_S)
    assert now.velocity.abs().max() == 0
    assert now.acceleration.abs().max() == 0


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_straight_path_begins_with_its_own_velocity_and_not_with_the_last_measurement(steps):
    velocity, start, dt_s = torch.tensor([3.0, 4.0]), torch.tensor([0.2, -0.1]), 0.1
    path = start + dt_s * torch.arange(1, steps + 1)[:, None] * velocity
    found = motion_along(path[None], standing(), dt_s)
    expected = torch.zeros(2) if steps == 1 else start
    torch.testing.assert_close(found.position[0], expected)
    way = (path[0] - expected) / dt_s
    torch.testing.assert_close(found.velocity[0], torch.stack([way.norm(), torch.tensor(0.0)]))
    torch.testing.assert_close(found.heading[0], torch.atan2(way[1], way[0]))


def test_a_path_that_stays_begins_at_rest_with_the_heading_of_the_track():
    path = torch.zeros(1, 3, 2, requires_grad=True)
    found = motion_along(path, standing(0.7), 0.1)
    torch.testing.assert_close(found.heading, torch.tensor([0.7]))
    torch.testing.assert_close(found.velocity, torch.zeros(1, 2), atol=1e-5, rtol=0)
    (slope,) = torch.autograd.grad(found.velocity.sum() + found.position.sum(), path)
    assert slope.isfinite().all()


def seen_in_part(rows=12):
    """Agents whose speed and heading change from row to row; the last of them is gone."""
    tracks = scene(batch=(3,), neighbors=0, history=rows, dtype=torch.float64).ego_past
    faster = torch.linspace(0.5, 1.5, rows, dtype=torch.float64).unsqueeze(-1)
    noisy = tracks.motion.position + 0.05 * torch.randn_like(tracks.motion.position)
    motion = tracks.motion._replace(position=noisy, velocity=faster * tracks.motion.velocity)
    valid = tracks.valid.clone()
    valid[0, [1, 4, 5]], valid[1, :-2], valid[2, -1] = False, False, False
    return tracks._replace(motion=motion, valid=valid)


def test_the_present_is_the_last_row_and_nothing_for_who_is_gone():
    tracks = seen_in_part()
    now = (current_position(tracks), current_heading(tracks), current_velocity(tracks))
    for agent in range(2):
        (x, y), angle = tracks.motion.position[agent, -1], float(tracks.motion.heading[agent, -1])
        speed = float(tracks.motion.velocity[agent, -1, 0])
        assert now[0][agent].tolist() == [x, y]
        assert now[1][agent] == angle
        expected = [speed * math.cos(angle), speed * math.sin(angle)]
        assert now[2][agent].tolist() == pytest.approx(expected)
    assert all((entry[2] == 0).all() for entry in now)
    assert (mean_velocity(tracks, 5, DT_S)[2] == 0).all()


def test_a_trend_is_the_parabola_of_weighted_least_squares_with_its_prior():
    tracks, memories = seen_in_part(), (0.4, 1.1)
    for memory, found in zip(memories, trends(tracks, memories, DT_S), strict=True):
        for agent in range(2):
            offset = (tracks.motion.position[agent] - tracks.motion.position[agent, -1]).numpy()
            time = DT_S * np.arange(-11, 1)
            root = np.sqrt(np.exp(time / memory) * tracks.valid[agent].numpy())[:, None]
            design = np.stack([np.ones(12), time, time**2 / 2], -1)
            prior = np.sqrt([0.01, 0.001, 0.0001])[:, None]
            wanted = np.zeros((3, 2))
            wanted[1] = current_velocity(tracks)[agent].numpy()
            fit = np.linalg.lstsq(
                np.concatenate([root * design, prior * np.eye(3)]),
                np.concatenate([root * offset, prior * wanted]),
                rcond=None,
            )[0]
            for entry, expected in zip(found, fit, strict=True):
                np.testing.assert_allclose(entry[agent].numpy(), expected, atol=1e-8)


@pytest.mark.parametrize("reach", [0.03, 5.0])
def test_who_rests_is_at_the_fading_mean_but_no_further_away_than_it_reaches(reach):
    tracks = seen_in_part()
    found = rest(tracks, 0.4, reach, DT_S)
    for agent in range(2):
        offset = (tracks.motion.position[agent] - tracks.motion.position[agent, -1]).numpy()
        weight = np.exp(DT_S * np.arange(-11, 1) / 0.4) * tracks.valid[agent].numpy()
        mean = weight @ offset / weight.sum()
        away = np.linalg.norm(mean)
        expected = mean / away * reach * np.tanh(away / reach)
        np.testing.assert_allclose(found.offset[agent].numpy(), expected, rtol=1e-6)
    assert found.offset[2].abs().max() == 0
    assert found.velocity.abs().max() == found.acceleration.abs().max() == 0


@pytest.mark.parametrize("speed", [0.0, 0.2, 1.0, 4.0])
def test_a_course_is_that_of_the_velocity_and_at_rest_that_of_the_track(speed):
    velocity, heading = speed * torch.tensor([0.6, 0.8]), torch.tensor(-0.5)
    slow = 0.3 * math.exp(-speed)
    x, y = 0.6 * speed + slow * math.cos(-0.5), 0.8 * speed + slow * math.sin(-0.5)
    assert current_course(velocity, heading).item() == pytest.approx(math.atan2(y, x), abs=1e-5)
