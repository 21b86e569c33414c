"""People who stop, or step into the way, right in front of the robot."""

import pytest
import torch

from diffstack_mmv.simulation import AbruptCrowd, OrcaCrowd
from diffstack_mmv.simulation.pedestrians import CrowdState, VisibleRobot


def crowd_at(*places):
    position = torch.tensor([places], dtype=torch.float64)
    goal = position + torch.tensor([8.0, 0.0], dtype=torch.float64)
    walking = torch.tensor([1.0, 0.0], dtype=torch.float64).expand_as(position)
    one = torch.ones(1, len(places), dtype=torch.float64)
    return CrowdState(position, walking, goal, 0.3 * one, one)


def robot_with(speed):
    zero = torch.zeros(1, 2, dtype=torch.float64)
    velocity = torch.tensor([[0.0, speed]], dtype=torch.float64)
    return VisibleRobot(zero, velocity, torch.tensor([0.3], dtype=torch.float64))


AHEAD, BEHIND, FAR = (1.0, 2.0), (-0.5, -2.0), (1.0, 6.0)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [({"stop_chance": 1.0}, [0.0, 0.0]), ({"stop_chance": 0.0, "step_chance": 1.0}, [-1.0, 0.0])],
)
def test_who_is_near_and_ahead_stops_or_steps_onto_the_line(settings, expected):
    crowd = crowd_at(AHEAD, BEHIND, FAR)
    usual = OrcaCrowd()(crowd, 0.25)
    velocity = AbruptCrowd(OrcaCrowd(), **settings)(crowd, 0.25, robot_with(3.0))
    assert velocity[0, 0].tolist() == pytest.approx(expected)
    assert torch.equal(velocity[0, 1:], usual[0, 1:])


@pytest.mark.parametrize("robot", [None, robot_with(0.2)])
def test_nobody_is_startled_by_a_robot_that_stands(robot):
    crowd = crowd_at(AHEAD)
    assert torch.equal(
        AbruptCrowd(OrcaCrowd(), stop_chance=1.0)(crowd, 0.25, robot), OrcaCrowd()(crowd, 0.25)
    )


def test_nobody_goes_beyond_the_line():
    velocity = AbruptCrowd(OrcaCrowd(), stop_chance=0.0, step_chance=1.0)(
        crowd_at((0.2, 2.0)), 0.25, robot_with(3.0)
    )
    assert velocity[0, 0].tolist() == pytest.approx([-0.2, 0.0])


def test_the_same_state_is_followed_by_the_same_step():
    crowd, robot = crowd_at(AHEAD, (0.6, 1.2)), robot_with(2.0)
    abrupt = AbruptCrowd(OrcaCrowd())
    assert torch.equal(abrupt(crowd, 0.25, robot), abrupt(crowd, 0.25, robot))


@pytest.mark.parametrize("wrong", [{"stop_chance": 1.1}, {"near_m": 0.0}, {"seed": -1}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        AbruptCrowd(OrcaCrowd(), **wrong)
