"""Unknowns of single windows for a given vehicle: maximum a posteriori by Gauss-Newton."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import direction
from diffstack_mmv.identification.measured.instruments import MeasurementNoise
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import (
    POSE,
    RECORDING,
    Linearised,
    RideSimulator,
)

START_M, START_RAD = 1.0, 1.0
"""Prior deviations of the pose at the start of a window."""


class LocalPrior(NamedTuple):
    """Gaussian prior of the unknowns of each window."""

    mean: Float[Tensor, "w l"]
    precision: Float[Tensor, "w l l"]


class WindowSystem(NamedTuple):
    """Weighted residuals of windows and their derivatives; gyro rows have their bias removed."""

    residual: Float[Tensor, "w o"]
    shared: Float[Tensor, "w o s"]
    local: Float[Tensor, "w o l"]


class WindowEstimate(NamedTuple):
    """Unknowns of each window with their covariance."""

    local: Float[Tensor, "w l"]
    covariance: Float[Tensor, "w l l"]
    cost: Float[Tensor, " w"]

    @property
    def recording(self) -> Float[Tensor, "w 4"]:
        """Steering offset (rad) and scale, speed scale, delay (s)."""
        return self.local[:, POSE : POSE + RECORDING]


def start_values(
    windows: RideWindows, simulator: RideSimulator, mean: Float[Tensor, "w 4"]
) -> Float[Tensor, "w l"]:
    """Unknowns with the pose of the recorded positions and no errors of the controls."""
    ahead = min(windows.steps, 10)
    way = windows.position[:, ahead] - windows.position[:, 0]
    turned = 0.5 * windows.speed[:, 0] * (windows.steer[:, :ahead] + mean[:, :1]).mean(-1)
    course = torch.atan2(way[:, 1], way[:, 0]) - turned * ahead * simulator.model.dt_s
    rest = way.new_zeros(len(way), 2 * simulator.knots(windows.steps))
    at_axle = windows.position[:, 0] - 0.3 * direction(course)
    return torch.cat([at_axle, course.unsqueeze(-1), mean, rest], -1)


def local_prior(
    start: Float[Tensor, "w l"],
    mean: Float[Tensor, "w 4"],
    precision: Float[Tensor, "w 4 4"],
    noise: MeasurementNoise,
) -> LocalPrior:
    """Prior of all unknowns of windows from that of their recordings; the pose is nearly free."""
    count = (start.shape[-1] - POSE - RECORDING) // 2
    pose = torch.tensor([START_M, START_M, START_RAD], dtype=start.dtype)
    steer, pace = (
        torch.full((count,), value, dtype=start.dtype)
        for value in (noise.steer_rad, noise.speed_share)
    )
    deviation = torch.cat([pose, torch.ones(RECORDING, dtype=start.dtype), steer, pace])
    whole = torch.diag_embed(deviation**-2).repeat(len(start), 1, 1)
    own = slice(POSE, POSE + RECORDING)
    whole[:, own, own] = precision
    middle = torch.cat([start[:, :POSE], mean, torch.zeros_like(start[:, POSE + RECORDING :])], -1)
    return LocalPrior(middle, whole)


def residuals(
    windows: RideWindows, found: Linearised, noise: MeasurementNoise, with_gyro: bool
) -> WindowSystem:
    """Residuals in units of their noise; without gyro those of the yaw rate have no weight.

    The bias of the gyro is marginalised: its prior lets the mean of a window's yaw rates move.
    """
    count = windows.position.shape[1] * 2
    distance = (found.outputs[:, :count] - windows.position.flatten(1)).unsqueeze(-1)
    rows = [distance, found.shared[:, :count], found.local[:, :count]]
    first, *others = [_along_and_across(windows, row, noise) for row in rows]
    parts = [first.squeeze(-1), *others]
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


def estimate_windows(
    simulator: RideSimulator,
    windows: RideWindows,
    shared: Float[Tensor, " s"],
    mean: Float[Tensor, "w 4"],
    precision: Float[Tensor, "w 4 4"],
    with_gyro: bool = False,
    iterations: int = 3,
    start: Float[Tensor, "w l"] | None = None,
) -> WindowEstimate:
    """Most probable unknowns of each window by itself.

    Args:
        simulator: Of the vehicle.
        windows: The windows.
        shared: θ of the vehicle and place of the antenna.
        mean: Prior mean of the unknowns of the recordings.
        precision: Its precision.
        with_gyro: Whether the yaw rates are used.
        iterations: Gauss-Newton steps; the problem is nearly linear.
        start: Where to begin; the recorded positions by default.
    """
    first = start_values(windows, simulator, mean)
    local = first if start is None else start
    prior = local_prior(first, mean, precision, simulator.noise)
    hessian, residual = prior.precision, first.new_zeros(len(first), 1)
    for _ in range(iterations):
        found = simulator.linearise(windows, shared, local, by_shared=False)
        system = residuals(windows, found, simulator.noise, with_gyro)
        hessian = system.local.mT @ system.local + prior.precision
        gap = (local - prior.mean).unsqueeze(-1)
        gradient = system.local.mT @ system.residual.unsqueeze(-1) + prior.precision @ gap
        residual = system.residual
        local = local - torch.linalg.solve(hessian, gradient).squeeze(-1)
    return WindowEstimate(local, torch.linalg.inv(hessian), 0.5 * residual.square().sum(-1))
