"""Rides of a known vehicle with known instruments, recorded like real ones."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from diffstack_mmv.identification.measured.instruments import (
    InstrumentPriors,
    MeasurementNoise,
)
from diffstack_mmv.identification.measured.rides import MeasuredRide, RideWindows
from diffstack_mmv.identification.measured.simulator import (
    INSTALLED,
    POSE,
    RECORDING,
    RideSimulator,
)
from diffstack_mmv.types import GRAVITY

KNOWN_SHARE = 0.97
"""Share of the positions that are measured; the others are bridged."""


class SyntheticRides(NamedTuple):
    """Rides with the truth behind them."""

    rides: list[MeasuredRide]
    shared: Float[Tensor, " s"]
    recording: Float[Tensor, "r 4"]


def draw_shared(simulator: RideSimulator, priors: InstrumentPriors, generator: Generator) -> Tensor:
    """Vehicle, antenna and gain of the encoder drawn from their priors, of shape (s,)."""
    vector = simulator.parameters
    theta = vector.theta_for(vector.prior.draw_values(generator))
    mean, std = priors.installed()
    drawn = mean + 0.5 * std * torch.randn(INSTALLED, generator=generator, dtype=torch.float64)
    return torch.cat([theta, drawn])


def record_rides(
    simulator: RideSimulator,
    priors: InstrumentPriors,
    recordings: int,
    steps: int,
    generator: Generator,
) -> SyntheticRides:
    """Drive gentle random curves at about 3 m/s, the wheel always driving, and measure them.

    Args:
        simulator: Of the true vehicle; its noise is that of the measurements.
        priors: The instruments are drawn from them, the delay within its deviation.
        recordings: Number of rides.
        steps: Steps of each.
        generator: Of the random numbers.
    """
    noise = simulator.noise
    windows = _gentle_curves(recordings, steps, simulator.model.dt_s, generator)
    mean, std = priors.recording()
    instruments = mean + std * _normal(generator, recordings, RECORDING)
    count = simulator.knots(steps)
    errors = [
        noise.curvature * _normal(generator, recordings, count),
        noise.speed_share * _normal(generator, recordings, count),
    ]
    pose = torch.zeros(recordings, POSE, dtype=torch.float64)
    driven = priors.freewheel(False)[0].expand(recordings, -1)
    local = torch.cat([pose, instruments, driven, *errors], -1)
    shared = draw_shared(simulator, priors, generator)
    true = simulator.simulate(windows, shared, local)
    position = _with_noise(true.position, noise, generator)
    known = torch.rand(recordings, steps + 1, generator=generator) < KNOWN_SHARE
    bias = noise.yaw_rate_bias.mean + noise.yaw_rate_bias.std * _normal(generator, recordings, 1)
    gyro = true.yaw_rate + bias + noise.yaw_rate_radps * _normal(generator, recordings, steps)
    lean = torch.atan(_lateral(true.yaw_rate, windows.speed) / GRAVITY)
    # the rows of a ride are means over steps, from which `cut_windows` takes the ends
    steer, speed, gyro = _held(windows.steer), _means(windows.speed), _held(gyro)
    rides = [
        MeasuredRide(f"{name}/bicycle", *columns)
        for name, *columns in zip(
            windows.names, position, known, steer, speed, gyro, lean, strict=True
        )
    ]
    return SyntheticRides(rides, shared, instruments)


def _normal(generator: Generator, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def _gentle_curves(recordings: int, steps: int, dt_s: float, generator: Generator) -> RideWindows:
    """Steering and speed as sums of slow waves, and nothing that was measured."""
    time = dt_s * torch.arange(steps + 1, dtype=torch.float64)
    waves = 2 * math.pi * torch.tensor([0.03, 0.08, 0.2, 0.4], dtype=torch.float64)
    phase = 2 * math.pi * torch.rand(recordings, 2, 4, generator=generator, dtype=torch.float64)
    swing = (waves * time[:, None] + phase.unsqueeze(2)).sin()
    steer = (swing[:, 0] @ torch.tensor([0.1, 0.08, 0.05, 0.02], dtype=torch.float64))[:, :-1]
    speed = 2.9 + 0.15 * swing[:, 1, :, :2].sum(-1)
    (rate,) = torch.gradient(steer, spacing=dt_s, dim=-1)
    nothing = torch.zeros_like(speed)
    return RideWindows(
        torch.arange(recordings),
        tuple(f"synthetic_{number}" for number in range(recordings)),
        torch.zeros(recordings, 2, dtype=torch.float64),
        nothing.unsqueeze(-1).expand(-1, -1, 2),
        nothing,
        nothing > -1,
        steer,
        rate,
        speed,
        nothing[:, 1:],
        nothing,
    )


def _with_noise(
    position: Float[Tensor, "r T1 2"], noise: MeasurementNoise, generator: Generator
) -> Float[Tensor, "r T1 2"]:
    """Positions with errors along and across the way."""
    way = position.diff(dim=1)
    way = torch.cat([way, way[:, -1:]], 1)
    along = way / way.norm(dim=-1, keepdim=True)
    across = torch.stack([-along[..., 1], along[..., 0]], -1)
    shape = (*position.shape[:2], 1)
    measured = position + noise.along_m * _normal(generator, *shape) * along
    return measured + noise.across_m * _normal(generator, *shape) * across


def _held(values: Float[Tensor, "r T"]) -> Float[Tensor, "r T1"]:
    """One more column; the last step goes on as it is."""
    return torch.cat([values, values[:, -1:]], -1)


def _means(speed: Float[Tensor, "r T1"]) -> Float[Tensor, "r T1"]:
    """Means over the steps from the speeds at their ends."""
    return torch.cat([0.5 * (speed[:, 1:] + speed[:, :-1]), speed[:, -1:]], -1)


def _lateral(yaw_rate: Float[Tensor, "r T"], speed: Float[Tensor, "r T1"]) -> Tensor:
    return _held(yaw_rate) * speed
