"""The point that takes any velocity at once."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.dynamics import Holonomic, rollout
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle

MODEL = Holonomic(load_vehicle("wheelchair"), dt_s=0.25).double()
TOP_MPS = 3.5
RESTING = torch.tensor([1.0, -2.0, 0.4, 0.0], dtype=torch.float64)


def numbers(*values):
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("course", [0.0, 1.0, 2.5, -3.0])
def test_it_goes_anywhere_at_once_and_faces_there(course):
    wanted = 2.0 * numbers(math.cos(course), math.sin(course))
    after = rollout(MODEL, RESTING, wanted.expand(2, 2))
    assert torch.allclose(after[1, :2], RESTING[:2] + 0.25 * wanted, atol=1e-3)
    assert float(after[1, 3]) == pytest.approx(2.0, abs=2e-3)
    assert math.remainder(float(after[2, 2]) - course, 2 * math.pi) == pytest.approx(0, abs=1e-2)


@given(st.floats(-TOP_MPS, TOP_MPS), st.floats(-TOP_MPS, TOP_MPS))
def test_it_is_never_faster_than_its_top_speed(x, y):
    after = MODEL(RESTING, numbers(x, y))
    gone = float((after[:2] - RESTING[:2]).norm())
    assert gone <= 0.25 * TOP_MPS
    assert gone >= 0.99 * 0.25 * min(math.hypot(x, y), TOP_MPS) - 1e-3


def test_at_rest_it_faces_where_it_did():
    after = rollout(MODEL, RESTING, torch.zeros(5, 2, dtype=torch.float64))
    assert torch.equal(after[-1], RESTING)


def test_it_faces_its_course_at_the_start():
    motion = Motion(numbers(0, 0), numbers(0.5)[0], numbers(0.0, 1.0), numbers(0.0)[0])
    state = MODEL.initial_state(motion)
    assert float(state[2]) == pytest.approx(0.5 + math.pi / 2)
    assert float(state[3]) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("control", [(0.0, 0.0), (2.0, -1.0), (-0.3, 0.1), (3.5, 3.5)])
def test_derivatives_hold_everywhere(control):
    state = RESTING.clone().requires_grad_()
    assert torch.autograd.gradcheck(MODEL, (state, numbers(*control).requires_grad_()))


def test_nothing_is_lost_where_it_faces_nowhere():
    facing_east = numbers(0.0, 0.0, 0.0, 0.0).requires_grad_()
    scale = MODEL(facing_east, numbers(-0.05, 0.0))[0].detach() / (-0.25 * 0.05)
    control = numbers(-0.05 / float(scale), 0.0).requires_grad_()
    after = MODEL(facing_east, control)
    found = torch.autograd.grad(after.sum(), (facing_east, control))
    assert all(bool(each.isfinite().all()) for each in (after, *found))


def test_an_arc_is_followed_from_rest():
    zero = torch.zeros((), dtype=torch.float64)
    started = MODEL(RESTING, MODEL.control_for(RESTING, zero + 4.0, zero))
    assert torch.allclose(
        started[:2] - RESTING[:2], 0.25 * numbers(math.cos(0.4), math.sin(0.4)), atol=1e-3
    )
    turned = MODEL(started, MODEL.control_for(started, zero, zero + 2.0))
    assert float(turned[2] - started[2]) == pytest.approx(0.5, abs=0.05)
    stopped = MODEL.control_for(turned, MODEL.hardest_braking(turned), zero)
    assert torch.allclose(stopped, torch.zeros_like(stopped), atol=1e-9)
