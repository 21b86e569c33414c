"""What is unknown about the instruments: offsets, scales, delay, and the place of the antenna."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive

SIZES = ("along_m", "across_m", "curvature", "speed_share")
"""Deviations that a fit can estimate."""
OF_RECORDING = ("steer_offset", "steer_scale", "speed_scale", "delay_s")
"""Unknowns of a recording, in the order of their columns."""
OF_FREEWHEEL = ("excess_mps", "coasting_mps2")
"""Unknowns of a window in which the vehicle coasts."""
INSTALLED_NAMES = ("antenna_ahead_m", "antenna_height_m", "steer_gain")
"""What is the same in all recordings."""


class Gaussian(NamedTuple):
    """Mean and standard deviation of a prior."""

    mean: float
    std: float


DRIVEN = Gaussian(-1.0, 1e-3)
"""Excess of speed in m/s of a vehicle that does not coast: so low that its wheel drives."""


@dataclass(frozen=True)
class InstrumentPriors:
    """Priors of the unknowns of a recording, and of what is installed on the vehicle.

    Attributes:
        steer_offset: Added to the measured steering, rad.
        steer_scale: Factor on it in one recording.
        speed_scale: Factor on the measured speed.
        delay_s: By how much the measured steering comes late; below zero, early.
        antenna_ahead_m: Place of the antenna ahead of the axle that does not steer.
        antenna_height_m: Its height, which the lean moves sideways.
        steer_gain: Factor on the steering that all recordings share: the gain of the encoder and
            the angle of the head axis, of which two values are documented that differ by 2.5 %. It
            cannot be told from the wheelbase.
        excess_mps: By how much the vehicle is faster than its driven wheel at the start of a
            window in which it coasts, as a freewheel allows.
        coasting_mps2: How fast it then loses speed; rolling resistance, air and slope.
        coasting_share: Share of the windows in which it coasts.
    """

    steer_offset: Gaussian = Gaussian(0.0, 0.05)
    steer_scale: Gaussian = Gaussian(1.0, 0.01)
    speed_scale: Gaussian = Gaussian(1.0, 0.06)
    delay_s: Gaussian = Gaussian(0.0, 0.03)
    antenna_ahead_m: Gaussian = Gaussian(0.3, 0.4)
    antenna_height_m: Gaussian = Gaussian(0.5, 0.3)
    steer_gain: Gaussian = Gaussian(1.0, 0.02)
    excess_mps: Gaussian = Gaussian(0.3, 0.3)
    coasting_mps2: Gaussian = Gaussian(0.1, 0.15)
    coasting_share: float = 0.1

    def recording(self) -> tuple[Float[Tensor, " 4"], Float[Tensor, " 4"]]:
        """Means and standard deviations of the unknowns of a recording, as `OF_RECORDING`."""
        return _columns(*(getattr(self, name) for name in OF_RECORDING))

    def freewheel(self, coasting: bool) -> tuple[Float[Tensor, " 2"], Float[Tensor, " 2"]]:
        """Means and standard deviations of excess and loss of speed in a window.

        Where the wheel drives, an excess below zero keeps them without effect.
        """
        return _columns(self.excess_mps if coasting else DRIVEN, self.coasting_mps2)

    def installed(self) -> tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]]:
        """Means and standard deviations of antenna and encoder, as `INSTALLED_NAMES`."""
        return _columns(*(getattr(self, name) for name in INSTALLED_NAMES))


@dataclass(frozen=True)
class MeasurementNoise:
    """Standard deviations of what is measured, the same for every model.

    Path curvature and speed have errors at knots every `knot_steps` steps, which stand for all
    that lies between a measured control and the path: play, slope, wind. Were they errors of the
    steering angle, a shorter wheelbase would make them smaller, and the best fit would shorten it.

    Attributes:
        along_m: Of a position along the course, where the time of a fix counts too.
        across_m: Across it.
        curvature: Of the path at a knot, 1/m.
        speed_share: Of the speed at a knot, relative.
        yaw_rate_radps: Of the gyro over a step.
        yaw_rate_bias: Prior of the bias of the gyro, rad/s.
        knot_steps: Steps of a knot.
    """

    along_m: float = 0.017
    across_m: float = 0.009
    curvature: float = 0.006
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
