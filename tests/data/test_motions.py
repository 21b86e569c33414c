"""Tracks from rows of position, velocity and heading."""

import math

import pytest
import torch

from diffstack_mmv.data.motions import motion_through, tracks_of, yaw_rate


def rows_of(count=6):
    """Rows x, y, vx, vy, heading of an agent at 2 m/s that drifts a little to its left."""
    time = 0.1 * torch.arange(count, dtype=torch.float64)
    heading = 3.0 + 0.5 * time
    vx = 2.0 * heading.cos() - 0.1 * heading.sin()
    vy = 2.0 * heading.sin() + 0.1 * heading.cos()
    return torch.stack([1.0 + time, 5.0 - time, vx, vy, heading], -1)


def made(states, past_rows=4, mode=3.0):
    return tracks_of(states, torch.tensor([1.8, 0.6, 1.7]), torch.tensor(mode), past_rows, 0.1)


def test_velocities_are_those_in_the_frame_of_the_body():
    tracks = made(rows_of())
    expected = torch.tensor([2.0, 0.1], dtype=torch.float64).expand(6, 2)
    torch.testing.assert_close(tracks.motion.velocity, expected)
    torch.testing.assert_close(tracks.motion.yaw_rate, torch.full((6,), 0.5, dtype=torch.float64))
    wrapped = [math.remainder(3.0 + 0.05 * row, 2 * math.pi) for row in range(6)]
    assert tracks.motion.heading.tolist() == pytest.approx(wrapped)
    assert tracks.extent.tolist() == pytest.approx([1.8, 0.6])
    assert (tracks.mode.item(), made(rows_of(), mode=math.nan).mode.item()) == (3, 0)


@pytest.mark.parametrize("column", range(5))
def test_a_row_of_which_anything_is_unknown_is_absent_and_zero(column):
    states = rows_of()
    states[2, column] = torch.nan
    tracks = made(states)
    assert tracks.valid.tolist() == [True, True, False, True, True, True]
    assert all((field[2] == 0).all() for field in tracks.motion)
    assert (tracks.motion.position[3] == states[3, :2]).all()


def test_yaw_rates_of_the_past_do_not_look_at_the_future():
    states = rows_of()
    states[4:, 4] += 0.2
    rates = made(states).motion.yaw_rate
    assert rates[:4].tolist() == pytest.approx([0.5] * 4)
    assert rates[4:].tolist() == pytest.approx([(2.5 + 0.5) / 2, 0.5])


@pytest.mark.parametrize(
    ("moving", "expected"),
    [
        ([True] * 4, [1.0, 1.5, 3.0, 4.0]),
        ([True, True, False, True], [1.0, 1.0, 0.0, 0.0]),
        ([False, True, True, True], [0.0, 2.0, 3.0, 4.0]),
    ],
)
def test_a_yaw_rate_is_the_mean_of_the_turns_seen_before_and_after(moving, expected):
    """Turns of 0.1, 0.2 and, no motion but a jump, 2 rad in steps of 0.1 s; at most 4 rad/s."""
    heading = torch.tensor([3.0, 3.1, 3.3 - 2 * math.pi, 5.3 - 2 * math.pi])
    found = yaw_rate(heading, torch.tensor(moving), 0.1)
    assert found.tolist() == pytest.approx(expected, abs=1e-5)


def test_motion_through_positions_on_a_circle_turns_and_moves_evenly():
    heading = 0.05 * torch.arange(40, dtype=torch.float64)
    position = 6.0 * torch.stack([heading.sin(), -heading.cos()], -1)
    found = motion_through(position, heading, 0.1)
    ahead = torch.tensor([3.0, 0.0], dtype=torch.float64).expand(38, 2)
    torch.testing.assert_close(found.velocity[1:-1], ahead, atol=2e-3, rtol=0)
    torch.testing.assert_close(found.yaw_rate, torch.full_like(heading, 0.5))
    assert torch.equal(found.position, position)
