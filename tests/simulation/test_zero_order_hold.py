"""Longer control steps, and another point of the body."""

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.simulation import ZeroOrderHold
from diffstack_mmv.types import Motion


@pytest.fixture(params=["kbm", "gm3"])
def inner(request):
    return model_of("bicycle", request.param, 0.05)


def test_one_held_step_is_many_steps(inner):
    state = inner.initial_state(turning())
    control = torch.tensor([[1.0, 0.2]])
    expected = inner(inner(inner(state, control), control), control)
    assert torch.equal(ZeroOrderHold(inner, 3)(state, control), expected)


def test_the_step_and_the_columns_are_told(inner):
    held = ZeroOrderHold(inner, 5)
    assert held.dt_s == pytest.approx(0.25)
    assert held.State is inner.State
    assert held.state_dim == inner.state_dim


def turning():
    """A vehicle that turns left at 2 m/s."""
    return Motion(
        torch.tensor([[1.0, 2.0]]),
        torch.tensor([0.3]),
        torch.tensor([[2.0, 0.1]]),
        torch.tensor([0.4]),
    )


def test_a_point_ahead_moves_sideways_in_a_turn():
    held = ZeroOrderHold(model_of("bicycle", "gm3", 0.05), 1, ahead_m=-0.45)
    state = held.initial_state(turning())
    back = held.motion(state, torch.zeros(1, 2))
    for found, expected in zip(back, turning(), strict=True):
        assert torch.allclose(found, expected, atol=1e-6)
    behind = held.model.motion(state, torch.zeros(1, 2))
    offset = behind.position - turning().position
    heading = torch.tensor([[0.3]])
    assert torch.allclose(offset, 0.45 * torch.cat([heading.cos(), heading.sin()], -1), atol=1e-6)


def test_no_step_is_refused(inner):
    with pytest.raises(ValueError, match="repeats"):
        ZeroOrderHold(inner, 0)


@pytest.fixture(params=[("bicycle", "kbm"), ("wheelchair", "gm3"), ("bicycle", "kbm_reversing")])
def governed(request):
    return ZeroOrderHold(model_of(*request.param, 0.05).double(), 5, speed_max_mps=1.0)


def commands(model, at, acceleration=None):
    """States of speeds `at` (m/s), and controls of an acceleration, the hardest by default."""
    speed = torch.tensor(at, dtype=torch.double)
    zero = torch.zeros_like(speed)
    flat = torch.stack([zero, zero], -1)
    state = model.initial_state(Motion(flat, zero, torch.stack([speed, zero], -1), zero))
    control = torch.stack([zero + model.bounds.upper[0], zero], -1)
    if acceleration is not None:
        control[..., 0] = acceleration
    return state, control


def speed_of(model, state):
    """Forward speed in m/s."""
    return model.motion(state, torch.zeros(*state.shape[:-1], 2).to(state)).velocity[..., 0]


def test_the_drive_pushes_no_further_than_to_the_top_speed(governed):
    state, control = commands(governed, (0.0, 0.7, 0.95, 1.0))
    after = speed_of(governed, governed(state, control)).detach()
    assert after.max() < 1.005
    assert after[0] > 0.3
    assert after[1:] == pytest.approx(torch.ones(3), abs=0.005)


def test_below_the_top_speed_nothing_is_changed(governed):
    state, control = commands(governed, (0.2, 0.5), acceleration=0.8)
    plain = ZeroOrderHold(governed.model, governed.repeats)
    assert torch.equal(governed(state, control), plain(state, control))


def test_a_top_speed_needs_an_acceleration_to_govern():
    with pytest.raises(ValueError, match=r"`controls` must contain acceleration.*top speed needs"):
        ZeroOrderHold(model_of("bicycle", "holonomic", 0.05), 5, speed_max_mps=1.0)
