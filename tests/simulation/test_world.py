"""One step of the world."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.simulation import (
    CircleCrossing,
    HolonomicRobot,
    RectangleFootprint,
    SquareCrossing,
    robot_named,
)
from diffstack_mmv.types import Outcome

STILL = torch.zeros(2, dtype=torch.float64)


def test_robot_and_pedestrians_move_at_once_from_the_present_state(world_with):
    world = world_with()
    state = world.start(CircleCrossing().case("test", 0))
    after = world.step(state, STILL + 0.4).state
    assert torch.allclose(after.robot.position - state.robot.position, STILL + 0.1)
    expected = world.crowd(state.pedestrians, 0.25)
    assert torch.equal(after.pedestrians.velocity, expected)
    assert after.time == 0.25


def test_a_step_leaves_the_state_that_it_was_given_alone(world_with):
    world = world_with()
    state = world.start(CircleCrossing().case("test", 0))
    before = state.pedestrians.position.clone()
    world.step(state, STILL)
    assert torch.equal(state.pedestrians.position, before)


def test_a_batch_of_episodes_equals_its_episodes_one_by_one(world_with):
    world, scenario = world_with(), CircleCrossing()
    together = world.step(world.start(scenario.cases("test", range(3))), STILL.expand(3, 2))
    for case in range(3):
        alone = world.step(world.start(scenario.case("test", case)), STILL)
        assert torch.equal(
            alone.state.pedestrians.position, together.state.pedestrians.position[case]
        )
        assert torch.equal(alone.judgement.clearance, together.judgement.clearance[case])


@pytest.mark.parametrize("visible", [True, False])
def test_pedestrians_avoid_the_robot_only_if_they_see_it(world_with, scene_with, visible):
    world = world_with(visible=visible, exact=True)
    state = world.start(scene_with(pedestrian=(3.0, 0.05), goal=(-3.0, 0.05)))
    outcomes = []
    for _ in range(40):
        state, judgement = world.step(state, STILL)
        outcomes.append(int(judgement.outcome))
    assert (Outcome.COLLISION in outcomes) is not visible


def test_an_observation_tells_no_goal_of_a_pedestrian(world_with):
    world = world_with()
    seen = world.observe(world.start(CircleCrossing().cases("test", range(2))))
    assert seen.pedestrian_position.shape == (2, 5, 2)
    assert seen.radius.tolist() == [0.3, 0.3]
    assert not any("human_goal" in name for name in seen._fields)


def test_a_human_inside_the_robot_at_the_start_is_refused(world_with, scene_with):
    with pytest.raises(ValueError, match="`scene` must start without a collision"):
        world_with().start(scene_with(pedestrian=(0.2, 0.0), goal=(5.0, 0.0)))


def test_a_rectangular_robot_has_its_own_clearance(world_with, scene_with):
    world = world_with(exact=True)
    state = world.start(scene_with(pedestrian=(0.0, 2.0), goal=(0.0, 2.0)))
    robot = HolonomicRobot()
    robot.footprint = RectangleFootprint(1.8, 0.6)
    longer = replace(world, robot=robot)
    assert world.clearance(state) == pytest.approx(1.4)
    assert longer.clearance(state) == pytest.approx(0.8)


def test_a_scenario_that_keeps_clear_of_the_box_starts_without_a_collision(world_with):
    robot = robot_named("bicycle", "kbm", 0.25, "vehicle")
    world = world_with(robot, exact=True)
    with pytest.raises(ValueError, match=r"21 of 500 below 0.* a `robot_radius_m` of 1\.46"):
        world.start(SquareCrossing().cases("test", range(500)))
    clear = SquareCrossing(robot_radius_m=1.46).cases("test", range(500))
    assert (world.clearance(world.start(clear)) >= 0).all()


@pytest.mark.parametrize("visible", [True, False])
@pytest.mark.parametrize("robot", [HolonomicRobot(), robot_named("bicycle", "gm3", 0.25)])
def test_clearance_and_path_have_gradients_in_the_actions(world_with, robot, visible):
    world = world_with(robot=robot, visible=visible, exact=True)
    state = world.start(CircleCrossing().cases("test", range(3)))
    actions = torch.full((2, 3, 2), 0.3, dtype=torch.float64, requires_grad=True)
    for action in actions:
        state, judgement = world.step(state, action)
    total = judgement.clearance.sum() + robot.motion(state.robot).position.sum()
    (gradient,) = torch.autograd.grad(total, actions)
    assert gradient.isfinite().all()
    assert (gradient[0].abs() > 0).all()


@pytest.mark.parametrize(
    ("settings", "argument"), [({"dt_s": 0.0}, "dt_s"), ({"dt_s": 0.3, "limit_s": 10.0}, "limit_s")]
)
def test_times_that_do_not_fit_are_refused(world_with, settings, argument):
    with pytest.raises(ValueError, match=f"`{argument}` must"):
        world_with(**settings)


@pytest.mark.parametrize(("dt_s", "steps"), [(0.25, 40), (0.5, 20), (2.0, 5)])
def test_an_episode_has_as_many_steps_as_fit_into_the_limit(world_with, dt_s, steps):
    assert world_with(dt_s=dt_s, limit_s=10.0).max_steps == steps


@pytest.mark.usefixtures("unchecked")
def test_whether_the_robot_is_seen_is_a_switch(world_with):
    with pytest.raises(ValueError, match="`robot_visible` must be"):
        replace(world_with(), robot_visible="no")


def test_an_action_of_the_wrong_size_is_refused(world_with):
    world = world_with()
    with pytest.raises(ValueError, match="`action` must have 2 columns"):
        world.step(world.start(CircleCrossing().case("test", 0)), torch.zeros(3).double())


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_an_action_that_is_not_finite_is_refused(world_with, value):
    world = world_with()
    state = world.start(CircleCrossing().cases("test", range(2)))
    action = torch.tensor([[0.0, 0.0], [0.0, value]]).double()
    with pytest.raises(ValueError, match="`action` must be finite"):
        world.step(state, action)


@pytest.mark.parametrize(
    "scenario",
    [CircleCrossing(humans=0), SquareCrossing(humans=1), SquareCrossing(humans=50)],
    ids=["nobody", "one", "fifty"],
)
@pytest.mark.parametrize("visible", [True, False])
def test_a_crowd_of_any_size_walks(world_with, scenario, visible):
    world = world_with(visible=visible)
    state = world.start(scenario.cases("test", range(2)))
    for _ in range(4):
        step = world.step(state, 0.3 + STILL.expand(2, 2))
        state = step.state
    assert state.pedestrians.position.shape == (2, scenario.humans, 2)
    assert state.pedestrians.position.isfinite().all()
    assert not step.judgement.clearance.isnan().any()
