"""Smooth replacements for functions with kinks or removable singularities.

Each is finite in value and in first and second derivative as long as the square of its argument
is: up to 1e19 in float32 and 1e153 in float64.
"""

import torch
from jaxtyping import Float
from torch import Tensor

SERIES_BELOW = 0.3  # rad; the truncated series are exact to double precision there


def soft_clamp(value: Float[Tensor, "*b"], limit: float | Tensor) -> Float[Tensor, "*b"]:
    """Clamp to (-limit, limit) as limit · tanh(value / limit), in the unit of `value`."""
    return limit * torch.tanh(value / limit)


def saturate(
    value: Float[Tensor, "*b m"],
    low: Float[Tensor, " m"],
    high: Float[Tensor, " m"],
    margin: float = 0.1,
) -> Float[Tensor, "*b m"]:
    """Pass values inside [low, high] unchanged and saturate smoothly outside.

    Beyond a bound the excess e becomes w tanh(e / w) with w = margin · (high - low): twice
    continuously differentiable, and never dead just outside of the bound.
    """
    width = margin * (high - low)
    inside = torch.minimum(torch.maximum(value, low), high)
    return inside + width * torch.tanh((value - inside) / width)


def floor_at_zero(value: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """ReLU with its right-hand derivative (1) at zero: a vehicle at rest can learn to start.

    NaN stays NaN.
    """
    return torch.where(value < 0, torch.zeros_like(value), value)


def safe_norm(vector: Float[Tensor, "*b n"], epsilon: float = 1e-12) -> Float[Tensor, "*b"]:
    """Euclidean norm sqrt(|x|² + ε), in the unit of `vector`, differentiable at zero."""
    return (vector.square().sum(-1) + epsilon).sqrt()


def smooth_maximum(
    first: Float[Tensor, "*b"], second: Float[Tensor, "*b"], width: float
) -> Float[Tensor, "*b"]:
    """Maximum (a + b + sqrt((a - b)² + w²)) / 2 with a corner rounded over `width`."""
    return 0.5 * (first + second + ((first - second).square() + width**2).sqrt())


def sinc(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return sin(x) / x for x in rad, by its series near zero, where the quotient fails."""
    small = angle.abs() < SERIES_BELOW
    square = torch.where(small, angle, torch.zeros_like(angle)).square()
    series = 1 - square / 6 * (
        1 - square / 20 * (1 - square / 42 * (1 - square / 72 * (1 - square / 110)))
    )
    far = torch.where(small, torch.ones_like(angle), angle)
    return torch.where(small, series, far.sin() / far)


def sinc_slope(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return (sin x - x cos x) / x² for x in rad: minus the derivative of sin(x) / x."""
    small = angle.abs() < SERIES_BELOW
    near = torch.where(small, angle, torch.zeros_like(angle))
    square = near.square()
    series = 1 - square / 10 * (
        1 - square / 28 * (1 - square / 54 * (1 - square / 88 * (1 - square / 130)))
    )
    far = torch.where(small, torch.ones_like(angle), angle)
    return torch.where(small, near / 3 * series, (far.sin() - far * far.cos()) / far.square())


def limiter_gain(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return S(x) / x = (1 + x⁴)^(-1/4) of the odd limiter S, dimensionless and even in x.

    S has the slope 1 at zero and stays inside of (-1, 1), for x up to 3e7 in size.
    """
    # x^8 of the square must stay finite in float32, also in second derivatives
    square = ratio.square().clamp(max=1e15)
    return (1 + square.square()).sqrt().rsqrt()


def limiter_rest(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return 1 - S(x) of the odd limiter, without cancellation where S comes close to 1.

    1 - S = (1 - S⁴) / ((1 + S)(1 + S²)) and 1 - S⁴ = 1 / (1 + x⁴) = (S / x)⁴.
    """
    gain = limiter_gain(ratio)
    limited = ratio * gain
    positive = limited.clamp_min(0)
    rest = gain.square().square() / ((1 + positive) * (1 + positive.square()))
    return torch.where(ratio > 0, rest, 1 - limited)


def arctan_ratio(tangent: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return atan(x) / x, by its series near zero where the quotient loses its derivatives."""
    small = tangent.abs() < 0.03
    square = torch.where(small, tangent, torch.zeros_like(tangent)).square()
    series = 1 - square * (
        1 / 3 - square * (1 / 5 - square * (1 / 7 - square * (1 / 9 - square / 11)))
    )
    far = torch.where(small, torch.ones_like(tangent), tangent)
    return torch.where(small, series, far.atan() / far)


def tanh_ratio(argument: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return tanh(x) / x, by its series near zero where the quotient loses its derivatives."""
    small = argument.abs() < 0.03
    square = torch.where(small, argument, torch.zeros_like(argument)).square()
    series = 1 - square * (1 / 3 - square * (2 / 15 - square * (17 / 315 - square * (62 / 2835))))
    far = torch.where(small, torch.ones_like(argument), argument)
    return torch.where(small, series, far.tanh() / far)
