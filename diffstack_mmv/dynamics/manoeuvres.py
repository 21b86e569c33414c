"""Scripted manoeuvres and recorded controls: accelerations and steering angles over time."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import (
    require,
    require_at_least,
    require_between,
    require_positive,
    require_whole,
)
from diffstack_mmv.dynamics.control_files import read_controls
from diffstack_mmv.dynamics.records import DriverInput

LARGEST = 1000
"""What no speed, acceleration, angle or curvature of a vehicle reaches, SI units."""
LONGEST_S = 3600
"""What takes longer is a mistake in a number, and more steps than are worth to be driven."""


def _require_duration(duration_s: float, remedy: str) -> None:
    """Refuse a manoeuvre that hardly ever ends."""
    ends = duration_s <= LONGEST_S
    found = f"{duration_s:g} s"
    require(ends, "manoeuvre", f"take at most {LONGEST_S} s", found, "", remedy)


def _times(duration_s: float, dt_s: float) -> Float[Tensor, " T"]:
    return dt_s * torch.arange(max(1, round(duration_s / dt_s)), dtype=torch.float64)


@dataclass(frozen=True)
class Slalom:
    """Curvature κ sin(2π t / period) at constant acceleration; one period is an S-curve.

    Args:
        speed_mps: Speed at the start.
        curvature: Largest curvature in 1/m, positive to start to the left.
        period_s: Length of one left and one right turn.
        periods: How many of them.
        acceleration_mps2: Acceleration throughout.

    Raises:
        ValueError: The period is not positive, there is not at least one, or a number is negative
            or too large.
    """

    speed_mps: float
    curvature: float
    period_s: float
    periods: int = 1
    acceleration_mps2: float = 0.0

    def __post_init__(self) -> None:
        require_between("speed_mps", self.speed_mps, 0, LARGEST)
        require_positive("period_s", self.period_s)
        require_whole("periods", self.periods)
        require_at_least("periods", self.periods, 1)
        for name in ("curvature", "acceleration_mps2"):
            require_between(name, getattr(self, name), -LARGEST, LARGEST)
        _require_duration(self.period_s * self.periods, "Give fewer or shorter periods.")

    def __call__(self, wheelbase_m: float, dt_s: float) -> DriverInput:
        """Inputs for a vehicle of this wheelbase."""
        times = _times(self.period_s * self.periods, dt_s)
        curvature = self.curvature * (2 * math.pi * times / self.period_s).sin()
        return DriverInput(
            torch.full_like(times, self.acceleration_mps2), (wheelbase_m * curvature).atan()
        )


@dataclass(frozen=True)
class Turn:
    """Turn by an angle on a radius, eased in and out over `ramp_s`, then go straight.

    A turn that takes less than a ramp at full curvature is eased in and out to a part of it.

    Args:
        speed_mps: Speed at the start.
        angle_rad: Change of heading at this speed, positive to the left.
        radius_m: Smallest radius of the turn.
        ramp_s: Time to steer in, and to steer out.
        straight_s: Straight driving before and after.
        acceleration_mps2: Acceleration throughout.

    Raises:
        ValueError: Speed, radius or ramp is not positive, a number is out of its range, or the turn
            takes too long.
    """

    speed_mps: float
    angle_rad: float
    radius_m: float
    ramp_s: float = 1.0
    straight_s: float = 1.0
    acceleration_mps2: float = 0.0

    def __post_init__(self) -> None:
        for name in ("speed_mps", "radius_m", "ramp_s"):
            require_positive(name, getattr(self, name))
        for name in ("angle_rad", "acceleration_mps2"):
            require_between(name, getattr(self, name), -LARGEST, LARGEST)
        require_at_least("straight_s", self.straight_s, 0)
        remedy = "Give a higher speed_mps, or a smaller radius_m."
        _require_duration(self._turning_s + 2 * self.straight_s, remedy)

    @property
    def _at_full_s(self) -> float:
        """How long the angle would take at full curvature."""
        return abs(self.angle_rad) * self.radius_m / self.speed_mps

    @property
    def _turning_s(self) -> float:
        # a ramp up and one down turn as far as one of them at full curvature
        return max(self._at_full_s, self.ramp_s) + self.ramp_s

    def __call__(self, wheelbase_m: float, dt_s: float) -> DriverInput:
        """Inputs for a vehicle of this wheelbase; the hold lasts until the angle is reached."""
        turning_s = self._turning_s
        times = _times(turning_s + 2 * self.straight_s, dt_s) - self.straight_s
        edge = torch.minimum(times, turning_s - times) / self.ramp_s
        share = 0.5 - 0.5 * (math.pi * edge.clamp(0, 1)).cos()
        sharpest = min(1.0, self._at_full_s / self.ramp_s) / self.radius_m
        curvature = math.copysign(sharpest, self.angle_rad) * share
        return DriverInput(
            torch.full_like(times, self.acceleration_mps2), (wheelbase_m * curvature).atan()
        )


@dataclass(frozen=True)
class Braking:
    """Straight ahead: roll, then brake until well after the halt.

    Args:
        speed_mps: Speed at the start.
        acceleration_mps2: Braking, negative.
        roll_s: Rolling before.
        hold_s: Braking after the halt.

    Raises:
        ValueError: The braking is not negative, a number is out of its range, or it takes too long.
    """

    speed_mps: float
    acceleration_mps2: float = -3.0
    roll_s: float = 1.0
    hold_s: float = 1.0

    def __post_init__(self) -> None:
        require_between("speed_mps", self.speed_mps, 0, LARGEST)
        require_between("acceleration_mps2", self.acceleration_mps2, -LARGEST, LARGEST)
        brakes, value = self.acceleration_mps2 < 0, self.acceleration_mps2
        require(brakes, "acceleration_mps2", "be negative, as it brakes", value)
        for name in ("roll_s", "hold_s"):
            require_at_least(name, getattr(self, name), 0)
        _require_duration(self._duration_s, "Brake harder, or roll and hold shorter.")

    @property
    def _duration_s(self) -> float:
        return self.roll_s + self.speed_mps / abs(self.acceleration_mps2) + self.hold_s

    def __call__(self, wheelbase_m: float, dt_s: float) -> DriverInput:
        """Inputs; straight for any wheelbase."""
        times = _times(self._duration_s, dt_s)
        acceleration = self.acceleration_mps2 * (times >= self.roll_s).double()
        return DriverInput(acceleration, torch.zeros_like(times))


@dataclass(frozen=True)
class RecordedControls:
    """Controls from a CSV file with the columns `acceleration_mps2` and `steer_rad`.

    Where there is a column `time_s` as well, its steps must be those of the simulation; other
    columns are left alone.

    Args:
        path: The file, one row per control step.
        speed_mps: Speed at the start.

    Raises:
        ValueError: The speed is negative or too large.
    """

    path: str | Path
    speed_mps: float = 0.0

    def __post_init__(self) -> None:
        require_between("speed_mps", self.speed_mps, 0, LARGEST)

    def __call__(self, wheelbase_m: float, dt_s: float) -> DriverInput:
        """Inputs as recorded.

        Raises:
            ValueError: As in `read_controls`.
        """
        controls = read_controls(Path(self.path), dt_s)
        return DriverInput(controls[:, 0], controls[:, 1])
