"""The vehicle that drives and the one its controller believes in."""

import pytest
import torch

from diffstack_mmv.simulation import (
    DiscFootprint,
    MPPIController,
    actuation,
    controller_model,
    drive,
    require_stoppable,
    vehicle_robot,
)
from diffstack_mmv.simulation.forecasters import ConstantVelocityForecaster
from diffstack_mmv.types import Outcome, map_tensors
from tests.simulation.conftest import LIMITS


@pytest.mark.parametrize(("vehicle", "braking"), [("bicycle", -3.0), ("wheelchair", -2.2)])
def test_the_tighter_limit_holds(driven, vehicle, braking):
    assert driven(vehicle).spec().limits.acceleration_min_mps2 == braking


def test_altered_vehicles_have_another_mass_and_friction(driven):
    spec = driven("bicycle", mass_factor=1.5, friction=0.3).spec()
    assert spec.mass_kg == pytest.approx(135.0)
    assert spec.parameters["friction"].entries()[0][0] == pytest.approx(0.3)


def test_equal_models_share_controls_and_reference_point(driven):
    control = torch.tensor([[1.0, 0.3]])
    assert torch.equal(actuation(driven(), driven())(control), control)
    assert controller_model(driven(), driven()).ahead_m == 0


@pytest.mark.parametrize(
    ("vehicle", "dynamics"),
    [("bicycle", "kbm"), ("bicycle", "unicycle"), ("wheelchair", "gm3"), ("tricycle", "gm3")],
)
def test_a_controller_believes_in_the_top_speed_of_the_robot(driven, scene_with, vehicle, dynamics):
    chosen = driven(vehicle, dynamics)
    robot, model = vehicle_robot(chosen), controller_model(chosen, chosen)
    names = model.Control._fields
    push = torch.tensor([2.0 if name == "acceleration" else 0.3 for name in names])
    state = robot.start(scene_with((9.0, 0.0), (9.0, 1.0)))
    believed = model.initial_state(map_tensors(torch.Tensor.float, robot.motion(state)))
    for _ in range(16):
        state = robot.step(state, push.double(), 0.25).state
        believed = model(believed, push)
    speeds = [
        each.velocity[0].item() for each in (robot.motion(state), model.motion(believed, push))
    ]
    assert speeds == pytest.approx([LIMITS["speed_max_mps"]] * 2, rel=0.05)


def test_a_kinematic_controller_steers_gm3_to_the_same_angle(driven):
    kinematic, true = driven(dynamics="kbm"), driven(dynamics="gm3")
    command = actuation(kinematic, true)(torch.tensor([[1.0, 0.3]]))
    angle = true.model(0.01).chassis.steering.clamped(command[:, 1])
    assert angle.item() == pytest.approx(0.3, abs=1e-6)
    back = actuation(true, kinematic)(command)
    assert torch.allclose(back, torch.tensor([[1.0, 0.3]]))


def test_reference_points_differ_by_the_rear_axle(driven):
    model = controller_model(driven(dynamics="kbm"), driven(dynamics="gm3"))
    assert model.ahead_m == pytest.approx(0.45)
    assert model.dt_s == pytest.approx(0.25)


def test_models_without_common_controls_are_refused(driven):
    with pytest.raises(ValueError, match="share its controls"):
        actuation(driven(dynamics="unicycle"), driven(dynamics="gm3"))


def test_a_vehicle_that_cannot_stop_is_refused(driven):
    require_stoppable(driven(), 8.0)
    with pytest.raises(ValueError, match="braking distance of 1.50 m"):
        require_stoppable(driven(), 1.0)


def test_mppi_drives_to_the_goal_and_repeats_itself(driven, world_with, scenario_of):
    world = world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=10.0)
    scene = scenario_of("circle").cases("train", [3])
    model = controller_model(driven(), driven(), step_s=0.125)
    records = [
        drive(world, scene, MPPIController(model, ConstantVelocityForecaster(), samples=128)).record
        for _ in range(2)
    ]
    assert records[0].outcome.tolist() == [Outcome.SUCCESS]
    assert torch.equal(records[0].controls, records[1].controls)


@pytest.mark.parametrize(("decision_s", "passed"), [(None, 1), (0.25, 1), (0.1, 0), (0.5, 2)])
def test_the_plan_of_mppi_moves_on_by_the_time_between_decisions(
    driven, world_with, scenario_of, decision_s, passed
):
    world = world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=10.0)
    seen = world.observe(world.start(scenario_of("circle").cases("train", [3])))
    model, people = controller_model(driven(), driven()), ConstantVelocityForecaster()
    controller = MPPIController(model, people, samples=8, decision_s=decision_s)
    one = MPPIController(model, people, samples=8, decision_s=model.dt_s / 2)
    whole = one.act(one.init(seen), seen).state.mean
    rest = controller.act(controller.init(seen), seen).state.mean
    assert torch.equal(rest[:, : 12 - passed], whole[:, passed:])
    assert torch.equal(rest[:, 12 - passed :], whole[:, -1:].expand(-1, passed, -1))
