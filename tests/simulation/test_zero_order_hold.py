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
