"""DiffKBM is the printed update, letter by letter, with a learnable wheelbase."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.dynamics import DiffKBM, ReversingFloor, SoftplusFloor, rollout
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle

SPEC = load_vehicle("bicycle")
MODEL = DiffKBM(SPEC, dt_s=0.1).double()


def tensor(*values):
    return torch.tensor(values, dtype=torch.float64)


@given(st.floats(-3, 3), st.floats(0, 10), st.floats(-4.9, 3.9), st.floats(-0.78, 0.78))
def test_step_is_the_printed_update(heading, speed, acceleration, steer):
    state = MODEL(tensor(1.0, 2.0, heading, speed), tensor(acceleration, steer))
    next_speed = max(speed + 0.1 * acceleration, 0.0)
    expected = tensor(
        1.0 + 0.1 * speed * math.cos(heading),
        2.0 + 0.1 * speed * math.sin(heading),
        heading + 0.1 * next_speed / SPEC.wheelbase.initial * math.tan(steer),
        next_speed,
    )
    assert torch.allclose(state, expected, atol=1e-12)


def test_speed_never_turns_negative():
    states = rollout(MODEL, tensor(0, 0, 0, 1.0), tensor(-5.0, 0.1).expand(10, 2))
    assert (states[:, 3] >= 0).all()
    assert states[-1, 3] == 0


def test_a_reversing_floor_lets_it_back_along_the_same_circle():
    model = DiffKBM(SPEC, dt_s=0.1, floor=ReversingFloor(1.0)).double()
    assert model.can_reverse
    assert not MODEL.can_reverse
    states = rollout(model, tensor(0, 0, 0, 1.0), tensor(-2.0, 0.3).expand(40, 2))
    assert float(states[:, 3].min()) == -1.0
    turned = (states[-1, 2] - states[-2, 2]) / 0.1
    assert float(turned) == pytest.approx(-math.tan(0.3) / SPEC.wheelbase.initial)
    motion = model.motion(states[-1], tensor(0.0, 0.3))
    assert float(motion.velocity[0]) == -1.0
    assert torch.allclose(model.initial_state(motion), states[-1], atol=1e-12)
    assert float(MODEL.initial_state(motion)[3]) == 0.0


def test_a_reversing_floor_is_the_relu_moved():
    speed = tensor(-3.0, -1.5, -1.0, 0.0, 2.0).requires_grad_()
    value = ReversingFloor(1.5)(speed)
    (slope,) = torch.autograd.grad(value.sum(), speed)
    assert torch.equal(value, tensor(-1.5, -1.5, -1.0, 0.0, 2.0))
    assert torch.equal(slope, tensor(0.0, 1.0, 1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="reverse_mps"):
        ReversingFloor(0.0)


def test_a_vehicle_that_may_reverse_does_so_unless_a_floor_is_given():
    spec = replace(SPEC, reverse=True)
    model = DiffKBM(spec, dt_s=0.1).double()
    assert model.can_reverse
    states = rollout(model, tensor(0, 0, 0, 1.0), tensor(-2.0, 0.0).expand(20, 2))
    assert float(states[-1, 3]) == pytest.approx(-3.0)
    assert not DiffKBM(spec, floor=SoftplusFloor()).can_reverse


def test_vehicle_at_rest_feels_the_throttle():
    control = tensor(0.0, 0.0).requires_grad_()
    states = rollout(MODEL, tensor(0, 0, 0, 0), control.expand(5, 2))
    (gradient,) = torch.autograd.grad(states[-1, 0], control)
    assert gradient[0] > 0


def test_softplus_floor_is_near_the_relu_and_never_dead():
    speed = tensor(-1.0, 0.0, 0.2, 3.0).requires_grad_()
    value = SoftplusFloor(0.05)(speed)
    (slope,) = torch.autograd.grad(value.sum(), speed)
    assert (value - speed.clamp_min(0) <= 0.05 * math.log(2) + 1e-12).all()
    assert (slope > 0).all()


def test_smaller_wheelbase_turns_faster_and_learns_its_gradient():
    end = rollout(MODEL, tensor(0, 0, 0, 4.0), tensor(0.0, 0.2).expand(10, 2))[-1]
    (gradient,) = torch.autograd.grad(end[2], list(MODEL.wheelbase.parameters()))
    assert gradient.sum() < 0


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0, 2.0), (1.0, 1.0, 3.0, 0.0)])
def test_derivatives_hold_in_state_control_and_wheelbase(point):
    state, control = tensor(*point).requires_grad_(), tensor(0.5, 0.2).requires_grad_()
    parameters = tuple(MODEL.wheelbase.parameters())
    assert torch.autograd.gradcheck(lambda *x: MODEL(x[0], x[1]), (state, control, *parameters))


def test_state_from_motion_gives_the_motion_back():
    motion = Motion(
        tensor(1.0, 2.0), tensor(0.5).squeeze(), tensor(3.0, 0.0), tensor(0.4).squeeze()
    )
    steer = torch.atan(MODEL.wheelbase() * 0.4 / 3.0)
    control = torch.stack([torch.zeros_like(steer), steer])
    again = MODEL.motion(MODEL.initial_state(motion), control)
    for before, after in zip(motion, again, strict=True):
        assert torch.allclose(before, after)


def test_wrong_number_of_columns_is_told_with_their_names():
    with pytest.raises(ValueError, match="acceleration, steer"):
        MODEL(tensor(0, 0, 0, 0), tensor(0, 0, 0))
