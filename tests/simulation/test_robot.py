"""The massless robots of the benchmark."""

import math

import pytest
import torch

from diffstack_mmv.simulation import CircleCrossing, HolonomicRobot, UnicycleRobot

SCENE = CircleCrossing().cases("test", range(3))


def action_of(first, second):
    return torch.tensor((first, second), dtype=torch.float64).expand(3, 2)


@pytest.mark.parametrize(
    ("robot", "action", "step_s", "way", "turn"),
    [
        (HolonomicRobot(), (0.5, -1.0), 0.2, (0.1, -0.2), 0.0),
        (UnicycleRobot(), (1.0, math.pi / 2), 0.5, (-0.5, 0.0), math.pi / 2),
    ],
    ids=["by its velocity, the heading kept", "turned first, then driven"],
)
def test_a_robot_moves_as_its_kind_does(robot, action, step_s, way, turn):
    travel = robot.step(robot.start(SCENE), action_of(*action), step_s)
    moved = travel.state.position - SCENE.robot_position
    assert torch.allclose(moved, action_of(*way))
    assert torch.allclose(travel.state.heading, SCENE.robot_heading + turn)


def test_the_heading_of_a_unicycle_stays_within_a_full_turn():
    robot = UnicycleRobot()
    state = robot.step(robot.start(SCENE), action_of(0.0, -3.0), 0.25).state
    assert ((state.heading >= 0) & (state.heading < 2 * math.pi)).all()


@pytest.mark.parametrize("robot", [HolonomicRobot(), UnicycleRobot()])
def test_path_velocity_and_motion_tell_the_same_step(robot):
    travel = robot.step(robot.start(SCENE), action_of(0.8, 0.3), 0.25)
    chord = travel.path.position[..., -1, :] - travel.path.position[..., 0, :]
    assert torch.allclose(chord, travel.velocity * 0.25)
    motion = robot.motion(travel.state)
    assert torch.allclose(motion.velocity.norm(dim=-1), robot.velocity(travel.state).norm(dim=-1))


def test_a_unicycle_moves_ahead_whichever_way_it_faces():
    robot = UnicycleRobot()
    for turn in (0.4, -2.0):
        motion = robot.motion(robot.step(robot.start(SCENE), action_of(0.8, turn), 0.25).state)
        assert torch.allclose(motion.velocity, action_of(0.8, 0.0))


@pytest.mark.parametrize("heading", [0.0, math.pi / 2, 2.0])
def test_a_body_sees_its_velocity_from_its_own_heading(heading):
    robot = HolonomicRobot()
    start = robot.start(SCENE._replace(robot_heading=torch.full((3,), heading).double()))
    motion = robot.motion(robot.step(start, action_of(0.6, -0.2), 0.25).state)
    ahead = 0.6 * math.cos(heading) - 0.2 * math.sin(heading)
    left = -0.6 * math.sin(heading) - 0.2 * math.cos(heading)
    assert torch.allclose(motion.velocity, action_of(ahead, left))


@pytest.mark.parametrize(
    ("robot", "lower", "upper"),
    [
        (HolonomicRobot(1.5), [-1.5, -1.5], [1.5, 1.5]),
        (UnicycleRobot(1.5), [0.0, -math.pi], [1.5, math.pi]),
        (HolonomicRobot(), [-1.0, -1.0], [1.0, 1.0]),
    ],
)
def test_actions_are_bounded_by_the_top_speed_and_a_turn_about(robot, lower, upper):
    assert [bound.tolist() for bound in robot.bounds] == [lower, upper]


@pytest.mark.parametrize("robot", [HolonomicRobot, UnicycleRobot])
def test_a_top_speed_that_is_not_positive_is_refused(robot):
    with pytest.raises(ValueError, match="`max_speed_mps` must be positive"):
        robot(0.0)
