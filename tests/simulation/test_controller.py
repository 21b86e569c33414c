"""DiffMPC among people: it arrives, keeps clear, and decides whatever happens."""

import pytest
import torch

from diffstack_mmv.simulation import Choice, DiscFootprint, drive, vehicle_robot
from diffstack_mmv.types import Motion, Outcome, map_tensors


def batched(scene):
    return map_tensors(lambda field: field.unsqueeze(0), scene)


@pytest.fixture
def crossing_world(world_with, driven):
    return world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=10.0)


@pytest.mark.slow
def test_it_reaches_the_goal_where_nobody_is_in_the_way(crossing_world, scene_with, controller_for):
    scene = batched(scene_with((9.0, 0.0), (9.0, 1.0), robot_goal=(0.0, 6.0)))
    record = drive(crossing_world, scene, controller_for())
    assert record.outcome.tolist() == [Outcome.SUCCESS]
    assert float(record.duration) < 3.6


def test_it_gives_way_to_somebody_head_on(crossing_world, scene_with, controller_for):
    scene = batched(scene_with((0.0, 8.0), (0.0, -8.0)))
    record = drive(crossing_world, scene, controller_for(starts=0))
    assert record.outcome.tolist() == [Outcome.SUCCESS]
    assert float(record.clearance.min()) > 0.1


def test_an_episode_does_not_depend_on_its_batch_mates(crossing_world, scenario_of, controller_for):
    scene = scenario_of("circle").cases("train", [0, 1])
    both = drive(crossing_world, scene, controller_for(starts=0))
    alone = drive(
        crossing_world, map_tensors(lambda field: field[1:], scene), controller_for(starts=0)
    )
    steps = int(alone.steps)
    assert torch.allclose(both.controls[1, :steps], alone.controls[0], atol=1e-4)


def test_an_observation_without_leading_dimensions_gives_one_action(
    crossing_world, scene_with, controller_for
):
    state = crossing_world.start(scene_with((9.0, 0.0), (9.0, 1.0)))
    assert controller_for(starts=0)(crossing_world.observe(state)).shape == (2,)


def test_it_brakes_where_the_model_diverges(crossing_world, scene_with, controller_for):
    controller = controller_for(starts=0)
    state = crossing_world.start(batched(scene_with((9.0, 0.0), (9.0, 1.0))))
    seen = crossing_world.observe(state)
    lost = seen._replace(goal=seen.goal * torch.nan)
    assert float(controller(lost)[0, 0]) == pytest.approx(-3.0)
    assert int(controller.decisions[-1].choice) == Choice.FALLBACK


def test_hopeless_situations_are_recorded_as_fallback(crossing_world, scene_with, controller_for):
    controller = controller_for(starts=0)
    state = crossing_world.start(batched(scene_with((0.0, 0.65), (0.0, 0.65))))
    controller(crossing_world.observe(state))
    assert controller.diagnosis()["fallback_share"].tolist() == [1.0]


def test_who_gets_no_closer_loses_patience(crossing_world, scene_with, controller_for):
    controller = controller_for(starts=0)
    seen = crossing_world.observe(crossing_world.start(batched(scene_with((9.0, 0.0), (9.0, 1.0)))))
    for decision in range(4):
        controller(seen._replace(time=seen.time + 0.25 * decision))
    assert controller._waited.tolist() == [pytest.approx(0.75)]


@pytest.mark.parametrize(("goal", "safe"), [(1.0, True), (8.0, False)])
def test_a_plan_is_refused_for_people_before_its_arrival_alone(
    goal, safe, crossing_world, scene_with, controller_for
):
    controller = controller_for(starts=0)
    scene = batched(scene_with((0.0, 2.0), (0.0, 2.0), robot_goal=(0.0, goal)))
    problem = controller.problem(crossing_world.observe(crossing_world.start(scene)))
    along = torch.linspace(0, 3, controller.planner.steps + 1)
    flat = torch.zeros_like(along)
    ahead = torch.stack([flat + 1, flat], -1)
    motion = Motion(torch.stack([flat, along], -1), flat + torch.pi / 2, ahead, flat)
    plan = map_tensors(lambda entry: entry[None, None], motion)
    controls = torch.zeros(1, 1, controller.planner.steps, 2)
    priced = controller.price(controller.planner, problem, controls, plan, torch.zeros(1))
    assert priced.safe.tolist() == [[safe]]


def test_the_optimiser_improves_on_its_start(crossing_world, scenario_of, controller_for):
    state = crossing_world.start(scenario_of("circle").cases("train", range(6)))
    controller = controller_for(starts=1)
    controller(crossing_world.observe(state))
    assert (controller.decisions[0].choice == Choice.OPTIMISED).float().mean() > 0.5


@pytest.mark.slow
def test_a_loss_on_whole_episodes_reaches_the_cost_weights(
    crossing_world, scenario_of, controller_for
):
    controller = controller_for(starts=1)
    controller.planner.solver = type(controller.planner.solver)(max_iterations=60, tolerance=1e-6)
    state = crossing_world.start(scenario_of("circle").cases("train", range(3)))
    for _ in range(3):
        state = crossing_world.step(
            state, controller.optimised(crossing_world.observe(state))
        ).state
    position = crossing_world.robot.motion(state.robot).position
    (position - state.goal).norm(dim=-1).sum().backward()
    gradient = controller.planner.cost.log_weight.grad
    assert bool(gradient.isfinite().all())
    assert float(gradient.abs().max()) > 0


@pytest.mark.parametrize("name", ["cruise_mps", "dt_s"])
def test_numbers_out_of_range_are_refused(name, controller_for):
    controller = controller_for()
    with pytest.raises(ValueError, match=name):
        type(controller)(controller.planner, controller.people, **{name: 0.0})
