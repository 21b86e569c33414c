"""Smooth functions: values, limits, and derivatives where the plain formulas have none."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.smooth import (
    arctan_ratio,
    floor_at_zero,
    limiter_gain,
    limiter_rest,
    safe_norm,
    saturate,
    sinc,
    sinc_slope,
    smooth_maximum,
    soft_clamp,
    tanh_ratio,
)

ANGLES = st.floats(-20, 20).filter(lambda x: abs(x) > 1e-3)


@given(ANGLES)
def test_sinc_is_sine_over_angle(angle):
    value = sinc(torch.tensor(angle, dtype=torch.float64)).item()
    assert math.isclose(value, math.sin(angle) / angle, rel_tol=1e-13, abs_tol=1e-15)


@given(ANGLES)
def test_sinc_slope_is_minus_the_derivative_of_sinc(angle):
    x = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
    slope = torch.autograd.grad(sinc(x), x)[0]
    assert torch.allclose(sinc_slope(x), -slope, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("ratio", "function"), [(arctan_ratio, math.atan), (tanh_ratio, math.tanh)]
)
@pytest.mark.parametrize("argument", [-40.0, -0.5, -0.03, 1e-9, 0.01, 0.02999, 0.03001, 2.0, 1e9])
def test_ratios_are_the_function_over_its_argument(ratio, function, argument):
    value = ratio(torch.tensor(argument, dtype=torch.float64)).item()
    assert math.isclose(value, function(argument) / argument, rel_tol=1e-13)


@given(st.floats(-1e3, 1e3).filter(bool))
def test_the_gain_of_the_limiter_is_its_formula(ratio):
    gain = limiter_gain(torch.tensor(ratio, dtype=torch.float64))
    assert math.isclose(gain, (1 + ratio**4) ** -0.25, rel_tol=1e-14)


@pytest.mark.parametrize("function", [sinc, sinc_slope, limiter_gain, arctan_ratio, tanh_ratio])
@pytest.mark.parametrize("size", [0.0, 1e-38, 1e-20, 1.0, 1e5, 1e10, 1e20])
def test_nothing_overflows_in_single_precision(function, size):
    x = torch.tensor([size, -size], requires_grad=True)
    value = function(x)
    (slope,) = torch.autograd.grad(value.sum(), x, create_graph=True)
    (bend,) = torch.autograd.grad(slope.sum(), x)
    for order, found in enumerate((value, slope, bend)):
        assert found.isfinite().all(), f"derivative {order}"


@pytest.mark.parametrize(
    "function",
    [
        *(sinc, sinc_slope, limiter_gain, limiter_rest, arctan_ratio, tanh_ratio),
        lambda x: soft_clamp(x, 0.7),
        lambda x: safe_norm(x.expand(3, -1).mT),
        lambda x: smooth_maximum(x, torch.zeros_like(x), 0.1),
        lambda x: saturate(x[:, None], x.new_tensor([-2.0]), x.new_tensor([3.0])),
    ],
)
@pytest.mark.parametrize(("dtype", "largest"), [(torch.float32, 1e19), (torch.float64, 1e153)])
def test_everything_is_finite_up_to_the_stated_size(function, dtype, largest):
    sizes = torch.tensor([0.0, 1.0, 1e-3 * largest, 0.5 * largest, largest], dtype=dtype)
    x = torch.cat([sizes, -sizes]).requires_grad_()
    value = function(x)
    (slope,) = torch.autograd.grad(value.sum(), x, create_graph=True)
    (bend,) = torch.autograd.grad(slope.sum(), x)
    for order, found in enumerate((value, slope, bend)):
        assert found.isfinite().all(), f"derivative {order}"


@pytest.mark.parametrize(
    "function", [sinc, sinc_slope, limiter_gain, arctan_ratio, tanh_ratio, torch.tanh]
)
@pytest.mark.parametrize("point", [0.0, 1e-9, 0.02999, 0.03, 0.29999, 0.3, 0.30001, 5.0])
def test_first_and_second_derivatives_hold_everywhere(function, point):
    x = torch.tensor([point], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, x)
    assert torch.autograd.gradgradcheck(function, x)


def test_limiter_has_slope_one_and_stays_below_one():
    x = torch.tensor([0.0, 1e-3, 1.0, 1e3, 3e7, -3e7], dtype=torch.float64, requires_grad=True)
    value = x * limiter_gain(x)
    (slope,) = torch.autograd.grad(value.sum(), x)
    assert slope[0] == 1
    assert (value.abs() <= 1).all()
    assert torch.isfinite(slope).all()


def test_floor_has_the_right_hand_derivative_at_zero():
    x = torch.tensor([-1.0, 0.0, 2.0], requires_grad=True)
    value = floor_at_zero(x)
    (slope,) = torch.autograd.grad(value.sum(), x)
    assert value.tolist() == [0.0, 0.0, 2.0]
    assert slope.tolist() == [0.0, 1.0, 1.0]
    assert floor_at_zero(torch.tensor([torch.nan, -1.0])).isnan().tolist() == [True, False]


@given(st.floats(-0.999, 0.999))
def test_saturation_leaves_the_inside_alone(share):
    low, high = torch.tensor([-2.0]), torch.tensor([3.0])
    value = torch.tensor([0.5 + 2.5 * share])
    assert torch.equal(saturate(value, low, high), value)


def test_saturation_is_bounded_and_never_dead_at_the_bound():
    low, high = torch.tensor([-2.0], dtype=torch.float64), torch.tensor([3.0], dtype=torch.float64)
    x = torch.tensor([[-1e6], [-2.0], [3.0], [3.2], [1e6]], dtype=torch.float64, requires_grad=True)
    value = saturate(x, low, high)
    (slope,) = torch.autograd.grad(value.sum(), x)
    assert value.min() >= -2.5
    assert value.max() <= 3.5
    assert torch.allclose(slope[1:3], torch.ones(2, 1, dtype=torch.float64))


def test_soft_clamp_is_odd_and_keeps_its_limit():
    x = torch.tensor([-100.0, -0.1, 0.1, 100.0])
    assert torch.allclose(soft_clamp(x, 0.7), -soft_clamp(-x, 0.7))
    assert soft_clamp(x, 0.7).abs().max() <= 0.7


def test_norm_is_differentiable_at_zero():
    x = torch.zeros(2, requires_grad=True)
    safe_norm(x).backward()
    assert torch.equal(x.grad, torch.zeros(2))


@given(st.floats(-5, 5), st.floats(-5, 5))
def test_smooth_maximum_lies_above_the_maximum_by_at_most_half_the_width(a, b):
    value = smooth_maximum(torch.tensor(a), torch.tensor(b), 0.1).item()
    assert max(a, b) - 1e-5 <= value <= max(a, b) + 0.05 + 1e-5


@given(st.floats(0, 1e4))
def test_limiter_and_its_rest_add_up_to_one(ratio):
    ratio = torch.tensor(ratio, dtype=torch.float64)
    assert math.isclose(
        (ratio * limiter_gain(ratio) + limiter_rest(ratio)).item(), 1, rel_tol=1e-15
    )


def test_rest_of_the_limiter_keeps_its_digits_in_single_precision():
    ratio = torch.logspace(-3, 3, 50, dtype=torch.float64)
    exact = -torch.expm1(-0.25 * torch.log1p(ratio**-4))
    assert ((limiter_rest(ratio.float()) - exact).abs() < 1e-5 * exact).all()


def test_rest_of_the_limiter_has_exact_derivatives_on_both_sides():
    ratio = torch.linspace(-5, 5, 21, dtype=torch.float64, requires_grad=True)
    torch.autograd.gradcheck(limiter_rest, ratio)
