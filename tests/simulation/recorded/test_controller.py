"""The controller among people who come and go."""

import pytest
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate

from diffstack_mmv.prediction import ConstantVelocity
from diffstack_mmv.simulation import (
    BlindDriver,
    ConstantVelocityForecaster,
    CrossingRules,
    DiscFootprint,
    ExactVerdict,
    LearnedForecaster,
    MPPIController,
    PedestrianTracker,
    RecordedCrossing,
    ReplayCrowd,
    StopAndGoDriver,
    TrackingController,
    World,
    controller_model,
    drive,
    vehicle_robot,
)
from diffstack_mmv.types import Outcome, map_tensors
from tests.simulation.conftest import composed_navigate
from tests.simulation.recorded.conftest import Reader, recorded

TIME = 0.1 * torch.arange(251, dtype=torch.float64)


def test_who_is_absent_is_no_obstacle_and_takes_no_room(crossing, controller_for, driven):
    controller = controller_for()
    world = World(vehicle_robot(driven()), ReplayCrowd(), ExactVerdict(8.0))
    seen = world.observe(world.start(crossing(humans=20).cases("test", range(3))))
    dynamics = controller.planner.dynamics
    told = ConstantVelocityForecaster()(None, seen, dynamics.dt_s, controller.planner.steps)
    obstacles = controller.problem(seen, told.forecast).obstacles
    count = seen.seen.sum(-1)
    assert obstacles.radius.shape[-1] == int(count.max()) < 20
    assert torch.equal(obstacles.valid.sum(-1), count)
    for case in range(3):
        there = seen.pedestrian_position[case][seen.seen[case]].float()
        now = obstacles.position[case][obstacles.valid[case]][:, 0, 0]
        assert torch.equal(now, there)


@pytest.mark.parametrize("name", ["diffmpc", "mppi", "tracking"])
def test_a_single_episode_with_a_past_is_a_batch_of_one(name, crossing, controller_for, driven):
    forecaster = LearnedForecaster(ConstantVelocity(30, 0.1), history_s=2.0)
    controller = MPPIController(controller_model(driven(), driven()), forecaster, samples=4)
    if name == "diffmpc":
        controller = controller_for(starts=0)
        controller.forecaster = forecaster
    if name == "tracking":
        controller = TrackingController(controller, PedestrianTracker())
    world = World(vehicle_robot(driven()), ReplayCrowd(), ExactVerdict(8.0))
    seen = world.observe(world.start(crossing().case("test", 0)))
    one = map_tensors(lambda entry: entry.unsqueeze(0), seen)
    single, batch = (controller.act(controller.init(each), each).action for each in (seen, one))
    assert torch.equal(single, batch.squeeze(0))


def test_stop_and_go_stops_for_who_walks_in_front(driven):
    walker = recorded(torch.stack((1.2 * (TIME - 12.5), 0 * TIME), -1)[None])
    scenario = RecordedCrossing(
        Reader({"test": {"one": walker}}),
        history_s=2.0,
        met=0,
        blind_mps=0.0,
        crossing=CrossingRules(turn_deg=0.0),
    )
    scene = scenario.cases("test", [0])
    robot = vehicle_robot(driven(), footprint=DiscFootprint())
    world = World(robot, ReplayCrowd(), ExactVerdict(20.0))
    model = controller_model(driven(), driven())
    record = drive(world, scene, StopAndGoDriver(model)).record
    blind = drive(world, scene, BlindDriver(model)).record
    assert record.outcome.tolist() == [Outcome.SUCCESS]
    assert float(record.clearance.min()) > 0
    assert record.steps >= blind.steps


@pytest.mark.parametrize("driver", [BlindDriver, StopAndGoDriver])
def test_a_driver_gives_controls_of_the_robot(driver, driven, world_with, scene_with) -> None:
    world = world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=2.0)
    scene = map_tensors(lambda field: field.unsqueeze(0), scene_with((9.0, 0.0), (9.0, 1.0)))
    seen, model = world.observe(world.start(scene)), controller_model(driven(), driven())
    plain = driver(model).act(None, seen).action
    turned = driver(model, actuate=lambda control: control.flip(-1)).act(None, seen).action
    assert torch.equal(turned, plain.flip(-1))
    assert not torch.equal(turned, plain)


@pytest.mark.parametrize("name", ["blind", "stop_and_go"])
def test_who_believes_in_controls_of_another_kind_is_refused(name) -> None:
    config = composed_navigate(f"controller={name}", "believed.dynamics=unicycle")
    with pytest.raises(InstantiationException, match="share its controls with the robot's"):
        instantiate(config.controller)
