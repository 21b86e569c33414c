"""Wherever the steered wheels are, a positive angle turns to the left."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, DriverInput, ExtendedUnicycle
from diffstack_mmv.dynamics.gm3 import DiffGM3WheelSpeed
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle


def rear_steered():
    bicycle = load_vehicle("bicycle")
    front, rear = bicycle.wheels
    wheels = replace(front, steered=False, driven=True), replace(rear, steered=True, driven=False)
    return replace(bicycle, wheels=wheels)


def steered_at_both_ends(front_m=0.5, rear_m=-0.5):
    tricycle = load_vehicle("tricycle")
    front, left, right = tricycle.wheels
    wheels = [replace(front, x_m=front_m)]
    wheels += [replace(wheel, x_m=rear_m, steered=True) for wheel in (left, right)]
    length = front_m - rear_m
    wheelbase = replace(tricycle.wheelbase, initial=length, low=length - 0.1, high=length + 0.1)
    return replace(tricycle, wheels=tuple(wheels), wheelbase=wheelbase)


def turned(kind, spec, steer=0.1, speed=2.0):
    """Heading in rad after two seconds under a driver's angle."""
    model, zero = kind(spec).double(), torch.zeros(()).double()
    ahead = Motion(torch.zeros(2).double(), zero, torch.tensor([speed, 0.0]).double(), zero)
    state = model.initial_state(ahead)
    with torch.no_grad():
        for _ in range(20):
            control = model.control_for_driver(state, DriverInput(zero, zero + steer))
            state = model(state, control)
    return float(model.motion(state, control).heading)


SPECS = [rear_steered(), steered_at_both_ends(), load_vehicle("skateboard"), load_vehicle("cart")]


@pytest.mark.parametrize("spec", SPECS, ids=["rear", "both", "skateboard", "cart"])
def test_a_driver_turns_all_models_alike(spec):
    expected = turned(DiffKBM, spec)
    assert expected > 0.2
    for kind in (DiffGM3, DiffGM3WheelSpeed, ExtendedUnicycle):
        assert turned(kind, spec) == pytest.approx(expected, rel=0.08), kind


def test_nothing_jumps_as_the_rear_axle_becomes_the_farther_one():
    before, after = (turned(DiffGM3, steered_at_both_ends(rear_m=x)) for x in (-0.499, -0.501))
    assert after == pytest.approx(before, rel=0.01)


@pytest.mark.parametrize("spec", SPECS, ids=["rear", "both", "skateboard", "cart"])
@pytest.mark.parametrize("kind", [DiffGM3, DiffGM3WheelSpeed])
def test_a_curve_to_the_left_is_a_positive_angle(spec, kind):
    model = kind(spec).double()
    state, zero = torch.zeros(8).double(), torch.zeros(()).double()
    state[2] = 2.0
    control = model.control_for(state, zero, zero + 0.1)
    assert control[-1] > 0
    driver = model.driver_input(state, control)
    again = model.control_for_driver(state, driver)
    torch.testing.assert_close(again[-1], control[-1])
