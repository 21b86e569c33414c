"""What the model must do as a vehicle, whatever its numbers."""

import math
from dataclasses import replace
from typing import NamedTuple

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, rollout
from diffstack_mmv.dynamics.gm3 import PaperBrush
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle, vehicle_names

NAMES = vehicle_names()
SINGLE_TRACK = ["bicycle", "scooter", "motorcycle"]


def build(name, **settings):
    return DiffGM3(load_vehicle(name), **settings).double().requires_grad_(False)


def moving(model, speed, yaw_rate=0.0):
    """State of straight or steadily turning motion at the origin."""
    one = torch.ones(1).double()
    velocity = torch.tensor([[speed, 0.0]]).double()
    motion = Motion(torch.zeros(1, 2).double(), 0 * one, velocity, yaw_rate * one)
    return model.initial_state(motion)


def held(model, state, acceleration, steer, steps):
    controls = torch.tensor([acceleration, steer]).double().expand(len(state), steps, 2)
    return rollout(model, state, controls)


def random_inputs(count):
    torch.manual_seed(1)
    state = torch.randn(count, 8).double() * torch.tensor([9, 9, 4, 0.5, 3, 1, 0.2, 0.3]).double()
    control = torch.randn(count, 2).double() * torch.tensor([4, 0.5]).double()
    return state, control


@pytest.mark.parametrize("name", NAMES)
def test_tire_forces_stay_inside_the_friction_circle(name):
    forces = build(name).wheel_forces(*random_inputs(5000))
    used = torch.hypot(forces.force_x, forces.force_y)
    assert (used <= forces.friction_limit * (1 + 1e-9) + 1e-4).all()


def kinetic_energy(spec, states):
    speed, turning = states[..., 2:4].square().sum(-1), states[..., 5].square()
    return 0.5 * (spec.mass_kg * speed + spec.parameters["yaw_inertia"].initial * turning)


class Gained(NamedTuple):
    """Kinetic energy in J before each step, and what the step adds to it."""

    energy: torch.Tensor
    gain: torch.Tensor


def gained(model, controls, lean=0.0):
    """What vehicles gain that slip, turn and lean at 5 m/s."""
    torch.manual_seed(3)
    state = moving(model, 5.0).repeat(len(controls), 1)
    state[:, 3], state[:, 5], state[:, 6] = torch.randn(3, len(controls))
    state[:, [3, 5, 6]] *= torch.tensor([0.3, 0.5, lean])
    energy = kinetic_energy(model.spec, rollout(model, state, controls))
    return Gained(energy[:, :-1], energy.diff(dim=1))


# a differential drive turns by driving forces, and is left out
UNDRIVEN = [name for name in NAMES if name not in ("wheelchair", "hoverboard")]


def braking():
    """Controls (192, 30, 2) without drive, at three brakes and with steering at random."""
    brake = torch.tensor([0.0, -1.0, -3.0]).double().repeat_interleave(64)
    steer = 0.1 * torch.randn(192, 30, generator=torch.Generator().manual_seed(4)).double()
    return torch.stack([brake[:, None].expand_as(steer), steer], -1)


@pytest.mark.parametrize("name", UNDRIVEN)
def test_energy_is_never_created_without_drive_and_camber(name):
    spec = load_vehicle(name)
    flat = replace(spec, wheels=tuple(replace(w, camber_reduction=1.0) for w in spec.wheels))
    gain = gained(DiffGM3(flat).double().requires_grad_(False), braking()).gain
    # at rest the smooth split of the command lets it creep by 0.3 mm/s
    assert (gain <= 1e-4).all()


@pytest.mark.parametrize("name", UNDRIVEN)
def test_hardly_any_energy_is_created_without_drive(name):
    energy, gain = gained(build(name), braking())
    # the work of camber thrust, and what the accuracy of a step allows in fast transients
    assert (gain <= 0.005 * energy + 0.05).all()


@pytest.mark.parametrize("name", SINGLE_TRACK)
def test_the_work_of_camber_thrust_is_no_error_of_the_step(name):
    """A leaning vehicle is pushed aside at a power that half a step leaves as it is."""
    coasting = torch.zeros(16, 20, 2).double()
    powers = [
        float(gained(build(name, dt_s=dt_s), coasting.repeat(1, count, 1), 0.3).gain.max()) / dt_s
        for count, dt_s in enumerate((0.02, 0.01), 1)
    ]
    assert powers[0] > 0.1
    assert powers[1] == pytest.approx(powers[0], rel=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_braking_ends_at_rest_and_stays_there(name):
    model = build(name)
    states = held(model, moving(model, 2.0), -2.0, 0.0, 80)[0]
    assert states[-1, 2].abs() < 0.02
    assert states[:, 2].min() > -1e-3


@pytest.mark.parametrize("name", NAMES)
def test_acceleration_command_has_gain_one(name):
    model = build(name)
    speeds = [0.5, 2.0, 5.0]
    start = torch.cat([moving(model, speed) for speed in speeds])
    end = held(model, start, 0.5, 0.0, 10)[:, -1, 2]
    assert end.tolist() == pytest.approx([speed + 0.5 for speed in speeds], abs=0.01)


@pytest.mark.parametrize(
    "name", ["bicycle", "scooter", "motorcycle", "tricycle", "tadpole", "cart"]
)
def test_steady_circle_follows_the_linear_understeer_formula(name):
    model = build(name)
    angle, speed = 0.01, torch.tensor([2.0, 5.0, 8.0]).double()
    start = torch.cat([moving(model, each) for each in speed.tolist()])
    end = held(model, start, 0.0, angle, 100)[:, -1]
    spec, per_wheel = model.spec, (3 * model.physics().cornering).squeeze(-1)
    front = sum(c for c, w in zip(per_wheel, spec.wheels, strict=True) if w.x_m > 0).item()
    rear = per_wheel.sum().item() - front
    length = spec.front_m + spec.rear_m
    gradient = spec.mass_kg * (spec.rear_m / front - spec.front_m / rear) / length
    damping = spec.parameters["yaw_inertia"].initial * 0.2 * speed / length * (1 / front + 1 / rear)
    yaw_rate = speed * angle / (length + gradient * speed**2 + damping)
    # contact lengths, trail and camber are not in the formula
    assert end[:, 5].tolist() == pytest.approx(yaw_rate.tolist(), rel=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_commanded_curvature_is_held(name):
    model = build(name)
    curvature = torch.tensor([0.03, -0.1]).double()
    state = torch.cat([moving(model, 3.0, 3.0 * each) for each in curvature.tolist()])
    control = model.control_for(state, torch.zeros(2).double(), curvature)
    end = rollout(model, state, control.unsqueeze(1).expand(2, 40, 2))[:, -1]
    driven = end[:, 5] / end[:, 2:4].norm(dim=-1)
    assert driven.tolist() == pytest.approx(curvature.tolist(), rel=0.06)


@pytest.mark.parametrize("name", SINGLE_TRACK)
def test_lean_follows_the_lateral_acceleration_in_a_steady_turn(name):
    model = build(name)
    start = torch.cat([moving(model, speed) for speed in (3.0, 6.0)])
    end = held(model, start, 0.0, 0.05, 100)[:, -1]
    assert (end[:, 6] > 0).all()  # a left turn leans to the left
    expected = (end[:, 2] * end[:, 5] / 9.81).atan()
    assert end[:, 6].tolist() == pytest.approx(expected.tolist(), rel=0.01)


def stiff(spec, factor):
    """The same vehicle on tyres that are stiffer and shorter: slip and trail vanish."""
    parameters = dict(spec.parameters)
    stiffness, length = (
        spec.wheel_parameter("tread_stiffness"),
        spec.wheel_parameter("contact_half_length"),
    )
    shrunk = tuple(value / factor for value in length.initial)
    raised = tuple(value * factor**3 for value in stiffness.initial)
    parameters["tread_stiffness"] = replace(stiffness, initial=raised, low=raised, high=raised)
    parameters["contact_half_length"] = replace(length, initial=shrunk, low=shrunk, high=shrunk)
    parameters["yaw_damping"] = replace(
        spec.parameters["yaw_damping"], initial=0.0, low=0.0, high=0.0
    )
    return replace(spec, parameters=parameters)


@pytest.mark.parametrize("name", SINGLE_TRACK)
def test_stiff_tires_give_the_kinematic_bicycle(name):
    spec = load_vehicle(name)
    fine = DiffKBM(spec, dt_s=0.002).double().requires_grad_(False)
    kinematic = torch.tensor([[-spec.rear_m, 0.0, 0.0, 4.0]]).double()
    for _ in range(1000):
        kinematic = fine(kinematic, torch.tensor([[0.5, 0.1]]).double())
    yaw_rate = 4.0 * math.tan(0.1) / (spec.front_m + spec.rear_m)
    distances = []
    for factor in (1.0, 4.0, 16.0):
        model = DiffGM3(stiff(spec, factor), substeps=4).double().requires_grad_(False)
        command = model.chassis.steering.command_for(torch.tensor(0.1).double()).item()
        state = moving(model, 4.0, yaw_rate)
        state[:, 3] = spec.rear_m * yaw_rate  # no slip at the rear axle
        end = held(model, state, 0.5, command, 20)[0, -1]
        rear = end[:2] - spec.rear_m * torch.stack([end[4].cos(), end[4].sin()])
        distances.append((rear - kinematic[0, :2]).norm().item())
    assert distances[0] > 1.5 * distances[1] > 1.5 * distances[2]
    assert distances[2] < 0.1  # of 9 m; the tyres still slip until the lean has settled


@pytest.mark.parametrize("law", [None, PaperBrush()], ids=["consistent", "paper"])
@pytest.mark.parametrize("name", NAMES)
def test_mirrored_motion_mirrors_the_path(name, law):
    model = build(name, tire=law)
    state, control = random_inputs(200)
    sign = torch.tensor([1, -1, 1, -1, -1, -1, -1, -1]).double()
    mirror = torch.tensor([1, -1]).double()
    rate = model.derivative(state, control)
    # the printed law divides by the speed of a wheel: rates of 4e7 beside one that stands, and
    # rounding, which differs between processors, grows with them
    rounding = 1e-8 + 1e-11 * rate.abs().amax(1, keepdim=True)
    pairs = (
        (model(sign * state, mirror * control), sign * model(state, control)),
        (model.derivative(sign * state, mirror * control), sign * rate),
    )
    for mirrored, expected in pairs:
        assert ((mirrored - expected).abs() <= rounding).all()


@pytest.mark.parametrize("name", ["bicycle", "wheelchair", "cart"])
def test_reversing_vehicle_drives_backwards(name):
    model = DiffGM3(replace(load_vehicle(name), reverse=True)).double()
    assert held(model, moving(model, 0.0), -1.0, 0.0, 20)[0, -1, 2].item() == pytest.approx(
        -2, abs=0.1
    )


def test_reversing_vehicle_brakes_to_a_stop_and_no_further():
    model = DiffGM3(replace(load_vehicle("wheelchair"), reverse=True)).double()
    assert model.can_reverse
    assert not build("wheelchair").can_reverse
    state, none = moving(model, 1.0), torch.zeros(1).double()
    for _ in range(30):
        state = model(state, model.control_for(state, model.hardest_braking(state), none))
    assert state[0, 2].abs() < 0.02


def test_resistance_slows_a_coasting_vehicle_straight_ahead():
    spec = load_vehicle("bicycle")
    rolling = replace(spec.parameters["rolling_resistance"], initial=0.01, low=0.0, high=0.05)
    drag = replace(spec.parameters["drag"], initial=0.3, low=0.0, high=1.0)
    rough = replace(
        spec, parameters={**spec.parameters, "rolling_resistance": rolling, "drag": drag}
    )
    model = DiffGM3(rough).double()
    _, left, speed, *turned = held(model, moving(model, 5.0), 0.0, 0.0, 10)[0, -1].tolist()
    expected = 5.0 - 1.0 * (0.01 * 9.81 + 0.3 / 90 * 4.92**2)
    assert speed == pytest.approx(expected, abs=0.01)
    assert [left, *turned] == pytest.approx([0.0] * 6, abs=1e-9)


def test_longer_vehicle_turns_less():
    spec = load_vehicle("bicycle")
    scale = replace(spec.parameters["length_scale"], initial=1.1, low=0.8, high=1.2)
    long = DiffGM3(replace(spec, parameters={**spec.parameters, "length_scale": scale})).double()
    short = build("bicycle")
    ratio = (
        held(long, moving(long, 3.0), 0.0, 0.1, 40)[0, -1, 5]
        / held(short, moving(short, 3.0), 0.0, 0.1, 40)[0, -1, 5]
    )
    assert ratio.item() == pytest.approx(1 / 1.1, rel=0.02)


@pytest.mark.parametrize("name", [*SINGLE_TRACK, "tricycle", "tadpole", "cart"])
def test_the_understeer_gradient_is_that_of_the_axles(name):
    model = build(name)
    spec, per_wheel = model.spec, (3 * model.physics().cornering).squeeze(-1)
    ahead = torch.tensor([wheel.x_m > 0 for wheel in spec.wheels])
    front, rear = per_wheel[ahead].sum(), per_wheel[~ahead].sum()
    shares = spec.rear_m / front, -spec.front_m / rear
    expected = spec.mass_kg * sum(shares) / (spec.front_m + spec.rear_m)
    told = model.derived_quantities()["understeer_gradient"]
    assert float(told.value) == pytest.approx(float(expected), rel=1e-6)
