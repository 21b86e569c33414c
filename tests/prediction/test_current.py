"""Estimates of the present motion."""

import pytest
import torch

from diffstack_mmv.prediction.current import current_velocity, mean_velocity, motion_along, trend
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
