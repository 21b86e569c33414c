"""What dynamics models take from a driver and tell of themselves, whatever their states."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class DriverInput(NamedTuple):
    """What a driver does, in the same terms for every model; time may be a leading dimension."""

    acceleration: Float[Tensor, "*b"]  # m/s²
    steer: Float[Tensor, "*b"]  # rad, of the front wheel of a bicycle as long, left is positive


class AccelerationRange(NamedTuple):
    """Accelerations from one to another; infinite where there is no end."""

    least: Float[Tensor, "*b"]  # m/s²
    most: Float[Tensor, "*b"]  # m/s²

    def within(self, other: "AccelerationRange") -> "AccelerationRange":
        """What is in both."""
        least = torch.maximum(self.least, other.least)
        return AccelerationRange(least, torch.minimum(self.most, other.most))


class DerivedQuantity(NamedTuple):
    """A quantity that follows from several physical parameters."""

    value: Float[Tensor, ""]
    unit: str


class WheelForces(NamedTuple):
    """Quantities of all wheels in the order of the vehicle's; zero at casters but for the load."""

    force_x: Float[Tensor, "*b wheels"]  # N, forward in the wheel's axes
    force_y: Float[Tensor, "*b wheels"]  # N, to the left
    moment_z: Float[Tensor, "*b wheels"]  # N m, before the vehicle's k_align
    normal_load: Float[Tensor, "*b wheels"]  # N
    steer: Float[Tensor, "*b wheels"]  # rad
    slip_x: Float[Tensor, "*b wheels"]
    slip_y: Float[Tensor, "*b wheels"]
    spin: Float[Tensor, "*b wheels"]  # 1/m
    wheel_speed: Float[Tensor, "*b wheels"]  # rad/s
    friction_limit: Float[Tensor, "*b wheels"]  # μ F_z in N
