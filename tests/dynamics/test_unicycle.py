"""The extended unicycle integrates its motion exactly."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from diffstack_mmv.dynamics import DriverInput, ExtendedUnicycle, rollout
from diffstack_mmv.vehicles import load_vehicle

MODEL = ExtendedUnicycle(load_vehicle("bicycle"), dt_s=0.1).double()


@pytest.mark.parametrize("yaw_rate", [0.0, 1e-8, 1e-3, -0.7, 2.4])
@pytest.mark.parametrize("acceleration", [0.0, -3.0, 2.0])
def test_step_agrees_with_a_fine_numerical_integration(yaw_rate, acceleration):
    def rate(_, x):
        return [x[3] * np.cos(x[2]), x[3] * np.sin(x[2]), yaw_rate, acceleration]

    start = [1.0, -2.0, 0.4, 3.0]
    expected = solve_ivp(rate, (0, 0.1), start, rtol=1e-12, atol=1e-12).y[:, -1]
    state = MODEL(
        torch.tensor(start, dtype=torch.float64),
        torch.tensor([yaw_rate, acceleration], dtype=torch.float64),
    )
    assert torch.allclose(state, torch.tensor(expected), atol=1e-10)


@given(st.floats(-2.4, 2.4), st.floats(-4, 3))
def test_two_half_steps_equal_one_step(yaw_rate, acceleration):
    half = ExtendedUnicycle(load_vehicle("bicycle"), dt_s=0.05).double()
    state = torch.tensor([0.0, 0.0, 0.3, 4.0], dtype=torch.float64)
    control = torch.tensor([yaw_rate, acceleration], dtype=torch.float64)
    twice = rollout(half, state, control.expand(2, 2))[-1]
    assert torch.allclose(MODEL(state, control), twice, atol=1e-12)


@pytest.mark.parametrize("yaw_rate", [0.0, 1e-6, 1.0])
def test_derivatives_hold_through_zero_yaw_rate(yaw_rate):
    state = torch.tensor([0.0, 0.0, 0.3, 4.0], dtype=torch.float64, requires_grad=True)
    control = torch.tensor([yaw_rate, 0.5], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(MODEL, (state, control))
    assert torch.autograd.gradgradcheck(MODEL, (state, control))


@pytest.mark.parametrize("speed", [3.0, -2.0])
def test_a_steering_angle_is_the_same_curve_ahead_and_in_reverse(speed):
    state = torch.tensor([0.0, 0.0, 0.0, speed], dtype=torch.float64)
    wanted = DriverInput(*torch.tensor([0.0, 0.3], dtype=torch.float64))
    control = MODEL.control_for_driver(state, wanted)
    states = rollout(MODEL, state, control.expand(20, 2))
    wheelbase = load_vehicle("bicycle").wheelbase.entries()[0][0]
    radius = wheelbase / wanted.steer.tan()
    centre = torch.stack([torch.zeros_like(radius), radius])
    assert torch.allclose((states[:, :2] - centre).norm(dim=-1), radius)
    assert torch.allclose(MODEL.driver_input(state, control).steer, wanted.steer)


@pytest.mark.parametrize("speed", [-2.0, 0.0, 3.0])
def test_its_state_is_taken_from_the_motion_that_it_tells(speed: float) -> None:
    state = torch.tensor([1.0, -2.0, 0.4, speed], dtype=torch.float64)
    motion = MODEL.motion(state, torch.tensor([0.3, 0.0], dtype=torch.float64))
    assert motion.velocity.tolist() == [speed, 0.0]
    assert torch.equal(MODEL.initial_state(motion), state)
    assert MODEL.can_reverse


def test_curvature_command_drives_that_circle():
    state = torch.tensor([0.0, 0.0, 0.0, 5.0], dtype=torch.float64)
    control = MODEL.control_for(state, torch.tensor(0.0), torch.tensor(0.2, dtype=torch.float64))
    states = rollout(MODEL, state, control.expand(40, 2))
    centre = torch.tensor([0.0, 5.0], dtype=torch.float64)
    assert torch.allclose(
        (states[:, :2] - centre).norm(dim=-1), torch.tensor(5.0, dtype=torch.float64)
    )
