"""DiffMPC among pedestrians: it arrives, keeps clear, and decides whatever happens."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.planning import TakeOptimum
from diffstack_mmv.simulation import (
    ConstantVelocityForecaster,
    DiscFootprint,
    ExactVerdict,
    drive,
    vehicle_robot,
)
from diffstack_mmv.types import Outcome, PlanOrigin, map_tensors


def batched(scene):
    return map_tensors(lambda field: field.unsqueeze(0), scene)


@pytest.fixture
def crossing_world(world_with, driven):
    return world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=10.0)


@pytest.mark.slow
def test_it_reaches_the_goal_where_nobody_is_in_the_way(crossing_world, scene_with, controller_for):
    scene = batched(scene_with((9.0, 0.0), (9.0, 1.0), robot_goal=(0.0, 6.0)))
    record, _ = drive(crossing_world, scene, controller_for())
    assert record.outcome.tolist() == [Outcome.SUCCESS]
    assert float(record.duration) < 3.6


def test_it_gives_way_to_somebody_head_on(crossing_world, scene_with, controller_for):
    scene = batched(scene_with((0.0, 8.0), (0.0, -8.0)))
    record, _ = drive(crossing_world, scene, controller_for(starts=0))
    assert record.outcome.tolist() == [Outcome.SUCCESS]
    assert float(record.clearance.min()) > 0.1


def test_an_episode_does_not_depend_on_its_batch_mates(crossing_world, scenario_of, controller_for):
    scene = scenario_of("circle").cases("train", [0, 1])
    both, _ = drive(crossing_world, scene, controller_for(starts=0))
    alone, _ = drive(
        crossing_world, map_tensors(lambda field: field[1:], scene), controller_for(starts=0)
    )
    steps = int(alone.steps)
    assert torch.allclose(both.controls[1, :steps], alone.controls[0], atol=1e-4)


def first_decision(controller, seen):
    """Action and state after one decision, without gradient."""
    with torch.no_grad():
        return controller.act(controller.init(seen), seen)


def test_an_observation_without_leading_dimensions_gives_one_action(
    crossing_world, scene_with, controller_for
):
    seen = crossing_world.observe(crossing_world.start(scene_with((9.0, 0.0), (9.0, 1.0))))
    assert first_decision(controller_for(starts=0), seen).action.shape == (2,)


def test_it_brakes_where_the_model_diverges(crossing_world, scene_with, controller_for):
    seen = crossing_world.observe(crossing_world.start(batched(scene_with((9.0, 0.0), (9.0, 1.0)))))
    lost = seen._replace(goal=seen.goal * torch.nan)
    action, state = first_decision(controller_for(starts=0), lost)
    assert float(action[0, 0]) == pytest.approx(-3.0)
    assert int(state.decisions[-1].origin) == PlanOrigin.FALLBACK


def test_hopeless_situations_are_recorded_as_fallback(crossing_world, scene_with, controller_for):
    controller = controller_for(starts=0)
    state = crossing_world.start(batched(scene_with((0.0, 0.65), (0.0, 0.65))))
    _, known = first_decision(controller, crossing_world.observe(state))
    assert controller.diagnosis(known)["fallback_share"].tolist() == [1.0]


def test_who_gets_no_closer_loses_patience(crossing_world, scene_with, controller_for):
    controller = controller_for(starts=0)
    seen = crossing_world.observe(crossing_world.start(batched(scene_with((9.0, 0.0), (9.0, 1.0)))))
    state = controller.init(seen)
    for _ in range(4):
        _, state = controller.act(state, seen)
    assert state.waited.tolist() == [pytest.approx(0.75)]


@pytest.mark.parametrize(("speed_mps", "waits"), [(0.1, True), (0.3, False)])
@pytest.mark.parametrize("dt_s", [0.25, 0.05])
def test_slow_progress_is_no_waiting_however_often_is_decided(
    crossing_world, scene_with, controller_for, dt_s, speed_mps, waits
):
    controller = controller_for(starts=0)
    controller.dt_s = dt_s
    seen = crossing_world.observe(crossing_world.start(batched(scene_with((9.0, 0.0), (9.0, 1.0)))))
    state, step = controller.init(seen), torch.tensor([0.0, speed_mps * dt_s])
    for number in range(4):
        position = seen.motion.position + number * step
        moved = seen._replace(motion=seen.motion._replace(position=position))
        _, state = controller.act(state, moved)
    assert (float(state.waited) > 0) is waits


def test_one_controller_serves_two_sets_of_episodes_in_turn(
    crossing_world, scenario_of, controller_for
):
    """What it remembers goes in and comes out: neither set sees anything of the other."""
    controller = controller_for(starts=0)
    scenes = [scenario_of("circle").cases("train", [case]) for case in (0, 1)]
    short = replace(crossing_world, verdict=ExactVerdict(4 * crossing_world.dt_s))
    apart = [drive(short, scene, controller).record for scene in scenes]
    worlds = [crossing_world.start(scene) for scene in scenes]
    known = [controller.init(crossing_world.observe(state)) for state in worlds]
    with torch.no_grad():
        for step in range(4):
            for number in range(2):
                seen = crossing_world.observe(worlds[number])
                action, known[number] = controller.act(known[number], seen)
                assert torch.equal(action[0], apart[number].controls[0, step].to(action))
                worlds[number] = crossing_world.step(worlds[number], action).state


def test_an_ended_episode_is_left_out(crossing_world, scenario_of, controller_for):
    controller = controller_for(starts=0)
    seen = crossing_world.observe(
        crossing_world.start(scenario_of("circle").cases("train", [0, 1]))
    )
    running = torch.tensor([False, True])
    action, state = first_decision(controller, seen._replace(running=running))
    assert (action[0] == 0).all()
    assert state.decisions[0].thought.rows.tolist() == [1]


def test_the_optimiser_improves_on_its_start(crossing_world, scenario_of, controller_for):
    seen = crossing_world.observe(
        crossing_world.start(scenario_of("circle").cases("train", range(6)))
    )
    controller = controller_for(starts=1)
    # everybody stays in this forecast: the price of all ways to walk off is not what is optimised
    controller.forecaster = ConstantVelocityForecaster()
    _, state = first_decision(controller, seen)
    assert (state.decisions[0].origin == PlanOrigin.OPTIMISED).float().mean() > 0.5


@pytest.mark.slow
def test_a_loss_on_whole_episodes_reaches_the_cost_weights(
    crossing_world, scenario_of, controller_for
):
    controller = controller_for(starts=1)
    controller.planner.choice = TakeOptimum()
    controller.planner.solver = type(controller.planner.solver)(max_iterations=60, tolerance=1e-6)
    state = crossing_world.start(scenario_of("circle").cases("train", range(3)))
    known = controller.init(crossing_world.observe(state))
    for _ in range(3):
        action, known = controller.act(known, crossing_world.observe(state))
        state = crossing_world.step(state, action).state
    position = crossing_world.robot.motion(state.robot).position
    (position - state.goal).norm(dim=-1).sum().backward()
    gradient = controller.planner.cost.log_weight.grad
    assert bool(gradient.isfinite().all())
    assert float(gradient.abs().max()) > 0


@pytest.mark.parametrize("name", ["cruise_mps", "dt_s"])
def test_numbers_out_of_range_are_refused(name, controller_for):
    controller = controller_for()
    with pytest.raises(ValueError, match=name):
        type(controller)(controller.planner, controller.forecaster, **{name: 0.0})
