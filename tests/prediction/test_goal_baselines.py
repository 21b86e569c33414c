"""Trajectories to a known goal."""

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline

from diffstack_mmv.prediction import constant_acceleration, hermite_spline, straight_line
from diffstack_mmv.types import Motion
from tests.prediction.samples import DT_S

PATHS = [straight_line, constant_acceleration, hermite_spline]


def motion(speed=3.0):
    heading = torch.tensor([0.3, -1.2], dtype=torch.float64)
    velocity = torch.tensor([[speed, 0.0], [speed, 0.0]], dtype=torch.float64)
    return Motion(
        torch.ones(2, 2, dtype=torch.float64),
        heading,
        velocity,
        torch.zeros(2, dtype=torch.float64),
    )


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_path_ends_at_the_goal(path, speed):
    goal = torch.tensor([[5.0, 2.0], [1.0, 1.0]], dtype=torch.float64)
    positions = path(motion(speed), goal, 30, DT_S)
    assert positions.shape == (2, 30, 2)
    assert torch.allclose(positions[:, -1], goal)


@pytest.mark.parametrize("path", [constant_acceleration, hermite_spline])
def test_path_starts_with_the_present_velocity(path):
    now = motion()
    positions = path(now, torch.zeros(2, 2, dtype=torch.float64), 3000, 0.001)
    velocity = (positions[:, 0] - now.position) / 0.001
    assert torch.allclose(
        velocity.norm(dim=-1), torch.full((2,), 3.0, dtype=torch.float64), atol=1e-2
    )


def test_acceleration_is_constant():
    positions = constant_acceleration(motion(), torch.zeros(2, 2, dtype=torch.float64), 30, DT_S)
    second = positions.diff(dim=1).diff(dim=1)
    assert torch.allclose(second, second[:, :1].expand_as(second), atol=1e-12)


def test_spline_has_no_acceleration_at_the_goal():
    positions = hermite_spline(motion(), torch.zeros(2, 2, dtype=torch.float64), 3000, 0.001)
    acceleration = positions.diff(dim=1).diff(dim=1) / 1e-6
    assert acceleration[:, -1].abs().max() < 1e-2 * acceleration[:, 0].abs().max()


@pytest.mark.parametrize(
    ("path", "cubic"), [(hermite_spline, True), (constant_acceleration, False)]
)
def test_path_is_the_polynomial_from_the_present_motion_to_the_goal(path, cubic):
    """The spline of scipy with these ends, or the parabola with this start, at 0.1 s to 3 s."""
    now, goal = motion(), torch.tensor([[5.0, 2.0], [-1.0, 4.0]], dtype=torch.float64)
    found = path(now, goal, 30, DT_S).numpy()
    time = DT_S * np.arange(1, 31)[:, None]
    for row, heading in enumerate((0.3, -1.2)):
        velocity = 3.0 * np.array([np.cos(heading), np.sin(heading)])
        ends = np.array([[1.0, 1.0], goal[row].numpy()])
        if cubic:
            spline = CubicSpline([0.0, 3.0], ends, bc_type=((1, velocity), (2, np.zeros(2))))
            expected = spline(time[:, 0])
        else:
            acceleration = 2 * (ends[1] - ends[0] - 3.0 * velocity) / 3.0**2
            expected = ends[0] + velocity * time + acceleration * time**2 / 2
        np.testing.assert_allclose(found[row], expected, atol=1e-12)


def test_a_straight_line_is_passed_in_equal_steps():
    now, goal = motion(), torch.tensor([[7.0, -2.0], [1.0, 4.0]], dtype=torch.float64)
    found = straight_line(now, goal, 3, DT_S)
    expected = torch.tensor(
        [[[3.0, 0.0], [5.0, -1.0], [7.0, -2.0]], [[1.0, 2.0], [1.0, 3.0], [1.0, 4.0]]]
    )
    torch.testing.assert_close(found, expected.double())
