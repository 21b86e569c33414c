"""Bounded parameters: exact priors, ranges that hold, precision that survives."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.vehicles import ExactBuffers, ParameterSpec, SoftClamped


def spec(initial=0.8, low=0.3, high=1.1, **changes):
    return ParameterSpec(initial, low, high, "1", changes.pop("learn", True), "a test", **changes)


@given(st.floats(-5, 5), st.floats(0.01, 10), st.floats(0.01, 0.99))
def test_value_starts_at_the_prior(low, width, share):
    initial = low + share * width
    module = SoftClamped(spec(initial, low, low + width)).double()
    assert module().item() == pytest.approx(initial, rel=1e-12, abs=1e-12 * width)


def test_model_built_in_single_precision_becomes_exact_in_double():
    module = SoftClamped(spec()).float().double()
    assert module().item() == pytest.approx(0.8, rel=1e-15)


@given(st.floats(-1e6, 1e6))
def test_value_stays_inside_its_range(offset):
    module = SoftClamped(spec()).double()
    torch.nn.init.constant_(module.offset, offset)
    assert 0.3 <= module().item() <= 1.1


def test_range_of_zero_width_is_exactly_constant():
    module = SoftClamped(spec(0.1, 0.1, 0.1)).double()
    torch.nn.init.constant_(module.offset, 3.0)
    assert module().item() == 0.1


@pytest.mark.parametrize(("tied", "shape"), [(False, (2,)), (True, ())])
def test_tied_wheels_share_one_learned_number(tied, shape):
    module = SoftClamped(spec((0.7, 0.9), tied=tied)).double()
    assert module.offset.shape == shape
    assert torch.allclose(module(), torch.tensor([0.7, 0.9]).double())


def test_frozen_parameter_has_no_gradient():
    assert not SoftClamped(spec(learn=False)).offset.requires_grad


def test_gradient_step_moves_the_value():
    module = SoftClamped(spec())
    module().backward()
    assert module.offset.grad > 0


def test_state_dictionary_holds_what_is_learned_and_restores_it():
    module, other = SoftClamped(spec()), SoftClamped(spec())
    torch.nn.init.constant_(module.offset, 0.3)
    assert list(module.state_dict()) == ["offset"]
    other.load_state_dict(module.state_dict())
    assert other() == module()


def test_constants_follow_device_and_type():
    module = ExactBuffers()
    module.register_exact("third", [1 / 3])
    assert module.float().double().get_buffer("third").item() == 1 / 3


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"initial": 1.2}, "`initial` must lie between"),
        ({"low": 2.0}, "`low` must be at most"),
        ({"initial": (0.8, 0.8), "low": (0.3,)}, "same number of entries"),
        ({"high": math.inf}, "must be finite"),
        ({"high": 1e7}, "or single precision loses it, but got 0.8 between low = 0.3"),
        ({"initial": 1.1 - 1e-7}, "`initial` must lie inside of its range by 5e-07 of it"),
    ],
)
def test_impossible_range_is_refused(changes, told):
    with pytest.raises(ValueError, match=told):
        spec(**changes)


def test_new_value_is_kept_inside_of_the_range():
    moved = spec((0.7, 0.9)).with_value([1.1 + 1e-8, 0.5], "fitted")
    assert 1.0 < moved.initial[0] < 1.1
    assert moved.initial[1] == 0.5
    assert moved.source == "fitted"
    with pytest.raises(ValueError, match=r"`value` must lie between low = 0.3 and high = 1.1, but"):
        moved.with_value([5.0, 0.5], "fitted")


def test_a_constant_takes_a_new_value_as_its_range():
    drag = spec(0.0, 0.0, 0.0).with_value(0.3, "measured")
    assert (drag.initial, drag.low, drag.high) == (0.3, 0.3, 0.3)
