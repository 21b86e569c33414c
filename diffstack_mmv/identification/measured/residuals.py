"""Residuals of windows in units of their noise, robust against jumps of the receiver."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.measured.instruments import MeasurementNoise
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import Linearised

PLAIN, ROBUST = 1e6, 3.0
"""Deviations beyond which the cost of a position grows linearly: none, and Huber's,
as receivers jump."""


class WindowSystem(NamedTuple):
    """Weighted residuals of windows and their derivatives; gyro rows have their bias removed."""

    residual: Float[Tensor, "w o"]
    shared: Float[Tensor, "w o s"]
    local: Float[Tensor, "w o l"]


def residuals(
    windows: RideWindows,
    found: Linearised,
    noise: MeasurementNoise,
    with_gyro: bool,
    robust: float = ROBUST,
) -> WindowSystem:
    """Residuals in units of their noise: of positions, then with gyro of yaw rates.

    The bias of the gyro is marginalised: its prior lets the mean of a window's yaw rates move.
    """
    count = windows.position.shape[1] * 2
    distance = (found.outputs[:, :count] - windows.position.flatten(1)).unsqueeze(-1)
    rows = [distance, found.shared[:, :count], found.local[:, :count]]
    first, *others = [_along_and_across(windows, row, noise) for row in rows]
    value, slope = _robust(first.squeeze(-1), robust)
    parts = [value, *(slope.unsqueeze(-1) * other for other in others)]
    if with_gyro:
        known = windows.yaw_rate.isfinite()
        measured = torch.where(known, windows.yaw_rate - noise.yaw_rate_bias.mean, 0.0)
        slack = known.double() / noise.yaw_rate_radps
        white = _without_bias(slack, noise.yaw_rate_bias.std)
        values = (found.outputs[:, count:] - measured).unsqueeze(-1)
        rows = [values, found.shared[:, count:], found.local[:, count:]]
        rows = [white @ row for row in rows]
        parts = [
            torch.cat([part, row.squeeze(-1) if part.dim() == 2 else row], 1)
            for part, row in zip(parts, rows, strict=True)
        ]
    return WindowSystem(*parts)


def _robust(residual: Float[Tensor, "w o"], bound: float) -> tuple[Tensor, Tensor]:
    """Values whose half squares are Huber's cost of the residuals, and their derivatives."""
    size = residual.abs().clamp_min(bound)
    root = (2 * bound * size - bound**2).sqrt()
    far = residual.abs() > bound
    value = torch.where(far, residual.sign() * root, residual)
    return value, torch.where(far, bound / root, 1.0)


def _along_and_across(
    windows: RideWindows, rows: Float[Tensor, "w o c"], noise: MeasurementNoise
) -> Float[Tensor, "w o c"]:
    """Rows of positions turned into the course and divided by their noise."""
    pairs = rows.unflatten(1, (-1, 2))
    cosine, sine = windows.course.cos().unsqueeze(-1), windows.course.sin().unsqueeze(-1)
    known = windows.known.to(rows.dtype).unsqueeze(-1)
    along = known * (cosine * pairs[:, :, 0] + sine * pairs[:, :, 1]) / noise.along_m
    across = known * (cosine * pairs[:, :, 1] - sine * pairs[:, :, 0]) / noise.across_m
    return torch.stack([along, across], 2).flatten(1, 2)


def _without_bias(weight: Tensor, bias_std: float) -> Float[Tensor, "w T T"]:
    """Whitening of weighted rows that share a bias: W (I - (1 - 1/√(1 + b² wᵀw)) w wᵀ/wᵀw)."""
    square = weight.square().sum(-1, keepdim=True).clamp_min(1e-12)
    shrink = 1 - (1 + bias_std**2 * square).rsqrt()
    unit = weight * square.rsqrt()
    inner = torch.eye(weight.shape[-1], dtype=weight.dtype)
    inner = inner - shrink.unsqueeze(-1) * unit.unsqueeze(-1) * unit.unsqueeze(-2)
    return inner * weight.unsqueeze(-2)
