"""What is unknown about the instruments: offsets, scales, delay, and the place of the antenna."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive

GRAVITY = 9.81
SIZES = ("along_m", "across_m", "steer_rad", "speed_share")
"""Deviations that a fit can estimate."""


class Gaussian(NamedTuple):
    """Mean and standard deviation of a prior."""

    mean: float
    std: float


@dataclass(frozen=True)
class InstrumentPriors:
    """Priors of the unknowns of a recording and of the antenna.

    Attributes:
        steer_offset: Added to the measured steering, rad.
        steer_scale: Factor on it.
        speed_scale: Factor on the measured speed.
        delay_s: By how much the measured steering comes late.
        antenna_ahead_m: Place of the antenna ahead of the axle that does not steer.
        antenna_height_m: Its height, which the lean moves sideways.
    """

    steer_offset: Gaussian = Gaussian(0.0, 0.05)
    steer_scale: Gaussian = Gaussian(1.0, 0.02)
    speed_scale: Gaussian = Gaussian(1.0, 0.06)
    delay_s: Gaussian = Gaussian(0.0, 0.03)
    antenna_ahead_m: Gaussian = Gaussian(0.3, 0.4)
    antenna_height_m: Gaussian = Gaussian(0.5, 0.3)

    def recording(self) -> tuple[Float[Tensor, " 4"], Float[Tensor, " 4"]]:
        """Means and standard deviations of the unknowns of a recording, in the order above."""
        return _columns(self.steer_offset, self.steer_scale, self.speed_scale, self.delay_s)

    def antenna(self) -> tuple[Float[Tensor, " 2"], Float[Tensor, " 2"]]:
        """Means and standard deviations of the place of the antenna."""
        return _columns(self.antenna_ahead_m, self.antenna_height_m)


@dataclass(frozen=True)
class MeasurementNoise:
    """Standard deviations of what is measured, the same for every model.

    Steering and speed have errors at knots every `knot_steps` steps, which stand for everything
    between the measured control and the path: play, slope, wind.

    Attributes:
        along_m: Of a position along the course, where the time of a fix counts too.
        across_m: Across it.
        steer_rad: Of the steering at a knot.
        speed_share: Of the speed at a knot, relative.
        yaw_rate_radps: Of the gyro over a step.
        yaw_rate_bias: Prior of the bias of the gyro, rad/s.
        knot_steps: Steps of a knot.
    """

    along_m: float = 0.017
    across_m: float = 0.009
    steer_rad: float = 0.006
    speed_share: float = 0.01
    yaw_rate_radps: float = 0.04
    yaw_rate_bias: Gaussian = field(default_factory=lambda: Gaussian(0.015, 0.015))
    knot_steps: int = 5

    def __post_init__(self) -> None:
        for name in (*SIZES, "yaw_rate_radps", "knot_steps"):
            require_positive(name, getattr(self, name))


def _columns(*priors: Gaussian) -> tuple[Tensor, Tensor]:
    values = torch.tensor(priors, dtype=torch.float64)
    return values[:, 0], values[:, 1]
