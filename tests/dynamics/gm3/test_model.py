"""DiffGM3 as a dynamics model: states, parameters, checkpoints, wheel speeds."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, rollout
from diffstack_mmv.dynamics.gm3 import (
    LIM2,
    ConsistentBrush,
    CoordinatedLean,
    DiffGM3WheelSpeed,
    ExplicitEuler,
    PaperBrush,
    RungeKutta4,
)
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle, vehicle_names


def motion(speed, yaw_rate, count=1):
    one = torch.ones(count).double()
    velocity = torch.stack([speed * one, 0 * one], -1)
    return Motion(torch.randn(count, 2).double(), 0.4 * one, velocity, yaw_rate * one)


def test_tracked_centre_of_gravity_moves_along_its_course():
    model = DiffGM3(load_vehicle("bicycle")).double()
    course = motion(4.0, 0.5)
    state = model.state_on_course(course)
    velocity = state[0, 2:4]
    direction = state[0, 4] + torch.atan2(velocity[1], velocity[0])
    assert direction.item() == pytest.approx(0.4)
    assert velocity.norm().item() == pytest.approx(4.0)
    # the rear axle slips no sideways
    assert (velocity[1] - 0.45 * state[0, 5]).abs() < 0.01


def test_course_at_rest_is_the_heading():
    state = DiffGM3(load_vehicle("bicycle")).double().state_on_course(motion(0.0, 1.0))
    assert state[0, 4].item() == pytest.approx(0.4)


@pytest.mark.parametrize(("vehicle", "leans"), [("scooter", True), ("cart", False)])
def test_initial_lean_is_that_of_a_steady_turn(vehicle, leans):
    state = DiffGM3(load_vehicle(vehicle)).double().initial_state(motion(5.0, 0.6))
    expected = 5.0 * 0.6 / 9.81 if leans else 0.0
    assert torch.tan(state[0, 6]).item() == pytest.approx(expected)


def test_learned_parameters_move_and_survive_a_checkpoint():
    model = DiffGM3(load_vehicle("bicycle"))
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=0.05)
    before = {name: value.clone() for name, value in model.physical_parameters().items()}
    state, control = torch.tensor([0, 0, 5.0, 0, 0, 0, 0, 0]), torch.tensor([-1.0, 0.2])
    for _ in range(3):
        optimizer.zero_grad()
        model(state, control).sum().backward()
        optimizer.step()
    after = model.physical_parameters()
    learned = ["friction", "tread_stiffness", "contact_half_length", "yaw_inertia", "yaw_damping"]
    assert all(bool((after[name] != before[name]).any()) for name in learned)
    copy = DiffGM3(load_vehicle("bicycle"))
    copy.load_state_dict(model.state_dict())
    assert torch.equal(copy(state, control), model(state, control))


def test_physical_parameters_have_their_plain_names():
    names = set(DiffGM3(load_vehicle("bicycle")).physical_parameters())
    assert {"friction", "tread_stiffness", "contact_half_length", "roll_damping"} <= names


def test_left_and_right_wheels_stay_alike_when_tied():
    model = DiffGM3(load_vehicle("cart"))
    torch.nn.init.constant_(model.get_submodule("friction").offset, 0.3)
    assert model.physical_parameters()["friction"].unique().numel() == 1


def test_state_columns_are_those_of_the_reference():
    assert DiffGM3.State._fields == (
        "position_x",
        "position_y",
        "velocity_forward",
        "velocity_left",
        "heading",
        "yaw_rate",
        "lean",
        "lean_rate",
    )


def test_leading_dimensions_broadcast():
    model = DiffGM3(load_vehicle("bicycle")).double()
    state, control = torch.zeros(3, 1, 8).double(), torch.randn(4, 2).double()
    assert model(state, control).shape == (3, 4, 8)
    assert model.derivative(state[0, 0], control).shape == (4, 8)
    assert model(state[:0, 0], control[:1]).shape == (0, 8)


@pytest.mark.parametrize("stepper", [ExplicitEuler(), RungeKutta4()])
def test_explicit_methods_agree_with_many_small_steps(stepper):
    spec = load_vehicle("wheelchair")
    state = torch.tensor([0, 0, 2.0, 0, 0, 0, 0, 0]).double()
    control = torch.tensor([0.3, 0.2]).double()
    ends = [
        DiffGM3(spec, substeps=steps, stepper=method).double()(state, control)
        for method, steps in ((stepper, 200), (None, 50))
    ]
    assert torch.allclose(*ends, atol=2e-3)


@pytest.mark.parametrize(
    ("substeps", "told"), [(0, "must be at least 1"), (1.5, "must be a whole number")]
)
@pytest.mark.usefixtures("unchecked")
def test_substeps_are_a_positive_whole_number(substeps, told):
    with pytest.raises(ValueError, match=f"`substeps` {told}"):
        DiffGM3(load_vehicle("bicycle"), substeps=substeps)


@pytest.mark.parametrize(
    ("part", "told"),
    [
        ({"tire": "paper"}, "`tire` must be a tyre law"),
        ({"tire": ConsistentBrush}, "`tire` must be a tyre law"),
        ({"stepper": "rk4"}, "`stepper` must be a numerical method"),
        ({"stepper": LIM2}, "`stepper` must be a numerical method"),
        ({"lean": CoordinatedLean}, "`lean` must be a lean law"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_the_name_or_the_class_of_a_part_is_none(part, told):
    with pytest.raises(TypeError, match=told):
        DiffGM3(load_vehicle("bicycle"), **part)


@pytest.mark.parametrize("name", vehicle_names())
def test_given_wheel_speed_is_reached(name):
    model = DiffGM3WheelSpeed(load_vehicle(name), tire=PaperBrush()).double().requires_grad_(False)
    driven = [wheel for wheel in model.spec.wheels if wheel.driven]
    assert model.Control._fields[:-1] == tuple(f"wheel_speed_{wheel.name}" for wheel in driven)
    speeds = [2.0 / wheel.radius_m for wheel in driven]
    controls = torch.tensor([*speeds, 0.0]).double().expand(1, 30, -1)
    end = rollout(model, model.initial_state(motion(1.0, 0.0)), controls)[0, -1]
    assert end[2].item() == pytest.approx(2.0, rel=0.01)


def test_unequal_wheel_speeds_turn_a_differential_drive():
    model = DiffGM3WheelSpeed(load_vehicle("hoverboard")).double().requires_grad_(False)
    controls = torch.tensor([10.0, 14.0, 0.0]).double().expand(1, 30, -1)
    end = rollout(model, model.initial_state(motion(1.0, 0.0)), controls)[0, -1]
    wheels = model.spec.wheels
    kinematic = (14 - 10) * wheels[0].radius_m / (wheels[0].y_m - wheels[1].y_m)
    assert end[5].item() == pytest.approx(kinematic, rel=0.03)
