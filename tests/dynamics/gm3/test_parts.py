"""Loads, steering, drive, slip and spin against reference vectors, and their invariants."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.dynamics.gm3 import DiffGM3
from diffstack_mmv.dynamics.gm3.drive import kink_of_gain, slip_per_share, split_acceleration
from diffstack_mmv.dynamics.gm3.lean import camber_spin
from diffstack_mmv.dynamics.gm3.slip import inverse_speed, reference_speed, rolling_speed
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import load_vehicle, vehicle_names
from tests.dynamics.gm3.conftest import VEHICLES

# the autobike is in no reference set
NAMES = [name for name in vehicle_names() if name != "autobike"]


def close(found, expected, scale=None):
    scale = expected.abs().max() if scale is None else scale
    return bool(((found - expected).abs() <= 1e-9 * scale).all())


def loads(model, acceleration, lateral):
    physics = model.physics()
    return model.chassis.loads(acceleration, lateral, physics.limits, physics.length_scale)


@pytest.mark.parametrize("vehicle", NAMES)
def test_loads_match_the_reference(vehicle, reference, helpers):
    found = loads(
        reference.model(vehicle), helpers[f"loads_{vehicle}_ax"], helpers[f"loads_{vehicle}_ay"]
    )
    assert close(found.mT, helpers[f"loads_{vehicle}_consistent"])


@pytest.mark.parametrize("vehicle", NAMES)
def test_acceleration_limits_match_the_reference(vehicle, reference):
    limits = reference.model(vehicle).physics().limits
    derived = reference.entries[vehicle]["derived"]
    assert limits.drive.item() == pytest.approx(derived["a_limit_drive"], rel=1e-12)
    assert limits.brake.item() == pytest.approx(derived["a_limit_brake"], rel=1e-12)


@pytest.mark.parametrize("vehicle", NAMES)
def test_loads_sum_to_the_weight_and_are_never_negative(vehicle):
    spec = load_vehicle(vehicle)
    model = DiffGM3(spec).double()
    found = loads(model, 60 * torch.randn(5000).double(), 60 * torch.randn(5000).double())
    weight = spec.mass_kg * GRAVITY
    assert (found.sum(0) - weight).abs().max() < 1e-12 * weight
    assert found.min() >= -1e-9 * weight


def test_wheel_without_load_is_refused():
    spec = load_vehicle("tricycle")
    spec = replace(spec, footprint=replace(spec.footprint, width_m=2.0))
    front, *others = spec.wheels
    with pytest.raises(ValueError, match="`wheels` must have the centre of gravity within"):
        replace(spec, wheels=(replace(front, y_m=1.0), *others))
    # on the edge of the outline the wheel at the other side carries nothing
    on_the_edge = spec.wheels[0].x_m / spec.wheels[1].x_m * spec.wheels[1].y_m
    edge = replace(spec, wheels=(replace(front, y_m=on_the_edge), *others))
    with pytest.raises(ValueError, match="`static load` must be positive, but got"):
        DiffGM3(edge)


@pytest.mark.parametrize("narrower", [1.0, 0.6], ids=["equal loads", "unequal loads"])
def test_staggered_wheels_take_the_pitching_moment_as_an_axle(narrower):
    spec = load_vehicle("tricycle")
    front, left, right = spec.wheels
    moved = replace(right, x_m=right.x_m + 0.1, y_m=narrower * right.y_m)
    spec = replace(spec, wheels=(front, left, moved))
    braking, straight = torch.tensor([-0.5]).double(), torch.zeros(1).double()
    found = loads(DiffGM3(spec).double(), braking, straight)[:, 0]
    moment = found @ torch.tensor(spec.per_wheel("x_m")).double()
    assert float(moment) == pytest.approx(0.5 * spec.mass_kg * spec.height_m, rel=1e-3)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_wheel_angles_match_the_reference(vehicle, reference, helpers):
    model = reference.model(vehicle)
    steering = model.chassis.steering
    clamped = steering.clamped(helpers[f"steer_{vehicle}_delta"])
    directions = steering(clamped, torch.ones(()).double())
    angles = torch.atan2(directions.sine, directions.cosine)
    expected = helpers[f"steer_{vehicle}_wheels"].mT[model.chassis.rolling]
    assert close(clamped, helpers[f"steer_{vehicle}_clamped"])
    assert close(angles.expand_as(expected), expected, 1.0)


@pytest.mark.parametrize("vehicle", vehicle_names())
def test_the_direction_of_every_wheel_has_the_length_of_one(vehicle: str) -> None:
    steering = DiffGM3(load_vehicle(vehicle)).double().chassis.steering
    angle = steering.limit_rad * torch.linspace(-1, 1, 9).double()
    sine, cosine = steering(angle, torch.tensor(0.9).double())
    lengths = torch.hypot(sine, cosine)
    torch.testing.assert_close(lengths, torch.ones_like(lengths))


@pytest.mark.parametrize("vehicle", ["bicycle", "cart", "skateboard", "wheelchair"])
def test_steering_command_inverts_the_soft_clamp(vehicle, reference):
    steering = reference.model(vehicle).chassis.steering
    angle = 0.97 * steering.limit_rad * torch.linspace(-1, 1, 50).double()
    assert torch.allclose(steering.clamped(steering.command_for(angle)), angle, atol=1e-12)


def test_command_split_matches_the_reference(helpers):
    split = split_acceleration(helpers["split_a"], 0.01)
    assert close(split.drive, helpers["split_drive"])
    assert close(split.brake, helpers["split_brake"])


@pytest.mark.parametrize("share", [-1e-6, 1e-6])
def test_the_frozen_gain_has_no_kink_where_a_force_changes_its_sign(share):
    at = torch.tensor(share).double().requires_grad_()
    (slope,) = torch.autograd.grad(slip_per_share(at, 0.98) - kink_of_gain(at), at)
    assert slope.abs() < 1e-3  # 1/9 with another sign on each side otherwise
    assert kink_of_gain(torch.tensor(0.5).double()) < 2e-5


def test_inverse_brush_law_matches_the_reference(helpers):
    share = helpers["inv_q"]
    assert close(share * slip_per_share(share, 0.98), helpers["inv_psisigma"])


def test_rolling_speed_matches_the_reference(helpers):
    forward, slip = helpers["roll_Vx"], helpers["roll_sigma"]
    found = rolling_speed(forward[None], slip[None], float(helpers["roll_v_eps"]))
    assert close(found[0], helpers["roll_Vr"])


@given(st.floats(-30, 30), st.floats(-0.89, 0.89))
def test_rolling_speed_gives_the_slip_exactly(forward, slip):
    forward, slip = torch.tensor([[forward]]).double(), torch.tensor([[slip]]).double()
    rolling = rolling_speed(forward, slip, 0.3)
    found = (rolling - forward) / reference_speed(rolling, 0.3)
    assert found.item() == pytest.approx(slip.item(), abs=1e-6)


def test_spin_matches_the_reference(helpers):
    forward, radius = helpers["spin_Vx"], helpers["spin_R"]
    per_radius = ((1 - helpers["spin_eps_gamma"]) / radius).unsqueeze(-1)
    camber = camber_spin(helpers["spin_gamma"], 1e9, per_radius).diagonal()
    found = inverse_speed(forward[None], 0.3)[0] * (forward * camber - helpers["spin_r"])
    assert close(found, helpers["spin_phi"])
