"""Vehicles as robots: fine integration, limits, delay, noise."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffKBM, ExtendedUnicycle, rollout
from diffstack_mmv.dynamics.catalogue import altered, model_of
from diffstack_mmv.seeding import stream
from diffstack_mmv.simulation import Actuation, CircleCrossing, VehicleRobot, vehicle_robot
from diffstack_mmv.types import Bounds
from diffstack_mmv.vehicles import load_vehicle

SCENE = CircleCrossing().cases("test", range(3))
SPEC = load_vehicle("bicycle")
SLOW, OTHERS = pytest.mark.slow, ("scooter", "tricycle")


def command(acceleration, steer):
    return torch.tensor((acceleration, steer), dtype=torch.float64).expand(3, 2)


def kbm(dt_s=0.01):
    return DiffKBM(SPEC, dt_s=dt_s)


def drive(robot, actions, dt_s=0.25):
    state, path = robot.start(SCENE), []
    for action in actions:
        travel = robot.step(state, action, dt_s)
        state = travel.state
        path.append(travel.path.position)
    return state, path


def test_a_step_is_the_rollout_of_its_fine_steps():
    robot = VehicleRobot(kbm())
    start, action = robot.start(SCENE), command(1.5, 0.3)
    expected = rollout(kbm().double(), start.model, action[:, None].expand(3, 25, 2))
    assert torch.allclose(robot.step(start, action, 0.25).state.model, expected[:, -1])


@pytest.mark.parametrize(
    "vehicle", ["bicycle", "wheelchair", *(pytest.param(v, marks=SLOW) for v in OTHERS)]
)
def test_ten_milliseconds_are_fine_enough_for_the_true_motion(vehicle):
    actions = [command(2.0, 0.2), command(1.0, -0.3), command(-3.0, 0.0)]
    ends = [
        drive(VehicleRobot(model_of(vehicle, "gm3", dt_s)), actions)[0].model[..., :2]
        for dt_s in (0.01, 0.0025)
    ]
    assert torch.allclose(*ends, rtol=0, atol=2e-3)


def test_the_path_has_one_point_per_fine_step_and_joins_the_next_one():
    _, (first, second) = drive(VehicleRobot(kbm()), [command(2.0, 0.1), command(0.0, -0.2)])
    assert first.shape == (3, 26, 2)
    assert torch.equal(first[:, -1], second[:, 0])


def test_the_robot_leaves_the_model_that_it_was_given_alone():
    model = kbm()
    robot = VehicleRobot(model)
    assert robot.model is not model
    assert model.bounds.lower.dtype == torch.float32
    assert model.wheelbase.offset.requires_grad


def test_a_vehicle_starts_at_rest_at_the_start_of_the_scene():
    robot = VehicleRobot(kbm())
    motion = robot.motion(robot.start(SCENE))
    assert torch.equal(motion.position, SCENE.robot_position)
    assert torch.equal(motion.heading, SCENE.robot_heading)
    assert (motion.velocity == 0).all()


def test_world_velocity_points_along_the_heading():
    robot = VehicleRobot(kbm())
    state, _ = drive(robot, [command(2.0, 0.0)])
    assert torch.allclose(robot.velocity(state), torch.tensor((0.0, 0.5)).double(), atol=1e-6)


@pytest.mark.parametrize("delay_steps", [1, 15, 40])
def test_a_delayed_command_acts_so_many_fine_steps_later(delay_steps):
    late = VehicleRobot(kbm(), Actuation(delay_s=delay_steps * 0.01))
    prompt = VehicleRobot(kbm())
    fine = [command(1.0, 0.0)] * 60
    waited, _ = drive(late, fine, dt_s=0.01)
    at_once, _ = drive(prompt, fine[delay_steps:], dt_s=0.01)
    assert torch.allclose(waited.model, at_once.model)


def test_noise_is_repeated_by_its_seed_and_differs_between_steps():
    noisy = Actuation(noise=(0.5, 0.0), seed=3)
    actions = [command(1.0, 0.0)] * 2
    first, _ = drive(VehicleRobot(kbm(), noisy), actions)
    again, _ = drive(VehicleRobot(kbm(), noisy), actions)
    other, _ = drive(VehicleRobot(kbm(), Actuation(noise=(0.5, 0.0), seed=4)), actions)
    assert torch.equal(first.model, again.model)
    assert not torch.equal(first.model, other.model)
    neighbors = [stream(seed, step) for seed in range(4) for step in range(200)]
    assert len(set(neighbors)) == len(neighbors)
    assert first.model[:, 3].unique().numel() == 3


def test_the_drive_pushes_no_further_than_to_the_top_speed():
    robot = VehicleRobot(kbm(), Actuation(speed_max_mps=2.0))
    state, _ = drive(robot, [command(2.0, 0.0)] * 8)
    assert torch.allclose(robot.motion(state).velocity[:, 0], torch.full((3,), 2.0).double())


def test_a_vehicle_that_can_reverse_is_no_faster_backwards():
    unicycle = ExtendedUnicycle(load_vehicle("wheelchair"), dt_s=0.01)
    robot = VehicleRobot(unicycle, Actuation(speed_max_mps=1.0))
    state, _ = drive(robot, [torch.tensor((0.0, -2.0), dtype=torch.float64).expand(3, 2)] * 8)
    assert torch.allclose(robot.motion(state).velocity[:, 0], torch.full((3,), -1.0).double())


def test_a_point_that_keeps_to_its_top_speed_needs_no_governor(driven):
    robot = vehicle_robot(driven(dynamics="holonomic"))
    state, _ = drive(robot, [torch.tensor((9.0, 9.0), dtype=torch.float64).expand(3, 2)] * 2)
    speed = robot.motion(state).velocity[:, 0]
    assert torch.allclose(speed, torch.full((3,), 3.0).double(), atol=0.01)


def test_actions_are_clipped_to_the_bounds():
    bounds = Bounds(torch.tensor((-3.0, -0.5)), torch.tensor((2.0, 0.5)))
    robot = VehicleRobot(kbm(), bounds=bounds)
    wild, _ = drive(robot, [command(50.0, 9.0)])
    tame, _ = drive(robot, [command(2.0, 0.5)])
    assert torch.equal(wild.model, tame.model)


def test_a_step_of_the_model_above_ten_milliseconds_is_refused():
    with pytest.raises(ValueError, match="`model.dt_s` must lie in"):
        VehicleRobot(kbm(dt_s=0.05))


@pytest.mark.parametrize(
    ("actuation", "argument"),
    [(Actuation(delay_s=0.015), "delay_s"), (Actuation(noise=(0.1,)), "noise")],
)
def test_actuation_that_does_not_fit_the_model_is_refused(actuation, argument):
    with pytest.raises(ValueError, match=f"`{argument}` must"):
        VehicleRobot(kbm(), actuation)


@pytest.mark.parametrize(
    ("setting", "value"), [("delay_s", -0.1), ("noise", (-1.0,)), ("speed_max_mps", 0.0)]
)
def test_impossible_actuation_is_refused_by_name(setting, value):
    with pytest.raises(ValueError, match=f"`{setting}` must"):
        Actuation(**{setting: value})


def test_a_load_scales_mass_and_inertias_and_nothing_else():
    loaded = altered(SPEC, mass_factor=1.2)
    assert loaded.mass_kg == pytest.approx(1.2 * SPEC.mass_kg)
    assert loaded.parameters["yaw_inertia"].initial == pytest.approx(8.4)
    assert loaded.parameters["friction"] == SPEC.parameters["friction"]


def test_a_slippery_road_sets_the_friction_of_every_tyre():
    slippery = altered(SPEC, friction=0.3)
    assert slippery.wheel_parameter("friction").initial == (0.3, 0.3)


@pytest.mark.parametrize(("vehicle", "dynamics"), [("bicycle", "magic"), ("carpet", "kbm")])
def test_an_unknown_vehicle_or_model_is_refused(vehicle, dynamics):
    with pytest.raises(ValueError, match="must be one of"):
        model_of(vehicle, dynamics, 0.01)
