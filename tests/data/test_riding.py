"""Situations of windows."""

import math

import pytest
import torch

from diffstack_mmv.data import Situations, situations
from diffstack_mmv.data.riding import angle_range
from diffstack_mmv.types import Motion, StackBatch, Tracks


def batch_of(position):
    """A batch whose ego is at these positions (71, 2) m."""
    position = (position - position[40])[None].float()
    rows = position.shape[1]
    heading = torch.zeros(1, rows)
    motion = Motion(position, heading, torch.zeros(1, rows, 2), heading)
    tracks = Tracks(motion, torch.ones(1, 2), torch.tensor([3]), torch.ones(1, rows).bool())
    past = tracks._replace(motion=Motion(*(part[:, :41] for part in motion)))
    future = tracks._replace(motion=Motion(*(part[:, 41:] for part in motion)))
    return StackBatch(past, future, past, future, position[:, -1], 0.1)


def path(speed, yaw_rate=0.0):
    """Positions at a speed of time, turning at a constant rate."""
    time = torch.arange(71) * 0.1
    heading = yaw_rate * time
    step = speed(time)[:, None] * torch.stack([heading.cos(), heading.sin()], -1) * 0.1
    return step.cumsum(0)


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        (path(lambda t: 3.0 + 0 * t), {"moving", "straight"}),
        (path(lambda t: 3.0 + 0 * t, 0.2), {"moving", "turning"}),
        (path(lambda t: 3.0 + 0 * t, 0.03), {"moving", "straight"}),
        (path(lambda t: 3.0 + 0 * t, math.radians(19.5) / 6), {"moving", "straight"}),
        (path(lambda t: 3.0 + 0 * t, math.radians(-20.5) / 6), {"moving", "turning"}),
        (path(lambda t: 0 * t), {"standing"}),
        (path(lambda t: 0.5 * (t - 3).clamp(min=0)), {"starting"}),
        (path(lambda t: 1.5 * (t - 3).clamp(min=0)), {"starting", "moving", "straight"}),
        (path(lambda t: (4 - t).clamp(min=0)), {"stopping", "moving", "straight"}),
        (path(lambda t: 0.6 + 0 * t), set()),
    ],
)
def test_a_motion_belongs_to_its_situations(position, expected):
    found = situations(batch_of(position))
    assert {name for name in Situations._fields if getattr(found, name)} == expected


def test_noise_at_standstill_is_no_motion():
    noise = 0.05 * torch.randn(71, 2, generator=torch.Generator().manual_seed(0))
    found = situations(batch_of(noise))
    assert found.standing.all()
    assert not (found.moving | found.starting | found.stopping).any()


@pytest.mark.parametrize(("speed", "moving"), [(1.01, True), (0.99, False)])
def test_a_seven_metre_path_is_the_limit_of_moving(speed, moving):
    assert situations(batch_of(path(lambda t: speed + 0 * t))).moving.all() == moving


ROUND = torch.remainder(torch.linspace(0, 5.0, 50), 2 * torch.pi).tolist()


@pytest.mark.parametrize(
    ("angle", "counted", "expected"),
    [
        ([3.0, 9.0, -3.2, 3.1], [True, False, True, True], 0.1),
        ([3.0, 9.0, -3.2, 3.1], [False] * 4, 0.0),
        (ROUND, [True] * 50, 5.0),
    ],
    ids=["a jump between", "nothing counted", "more than half a turn"],
)
def test_an_angle_range_counts_only_what_is_counted_and_knows_whole_turns(angle, counted, expected):
    found = angle_range(torch.tensor(angle), torch.tensor(counted))
    torch.testing.assert_close(found, torch.tensor(expected))
