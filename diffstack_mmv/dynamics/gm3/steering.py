"""From the steering command to the direction of every wheel.

A direction is given by its sine and cosine, so that no angle has to be formed: Ackermann wheels of
short vehicles may turn beyond a right angle, where the printed arctan changes its branch. Source:
GM3, Sec. III; DMMV, Sec. IV-B.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.smooth import soft_clamp
from diffstack_mmv.vehicles import (
    AckermannSteering,
    DifferentialDrive,
    ExactBuffers,
    Steering,
    TruckSteering,
    WheelSpec,
    turning_axle_m,
)
from diffstack_mmv.vehicles.layout import steered_length_m

COMMAND_SHARE = 0.98  # of the limit, the largest angle that the soft clamp is inverted for


class Directions(NamedTuple):
    """Sine and cosine of the steering angle of each wheel."""

    sine: Float[Tensor, "wheels n"]
    cosine: Float[Tensor, "wheels n"]


class WheelSteering(ExactBuffers):
    """How a command turns the wheels.

    The command δ is softly clamped, here and nowhere else:

        δ_c = δ_max tanh(δ / δ_max)

    A positive command turns the vehicle to the left, wherever its steered wheels are.

    Args:
        limit_rad: Limit δ_max of the soft clamp.
        bicycle_share: Distance of the wheel that the command tells from the turning axle, as a
            share of the length of the steered vehicle: below 1 where wheels at both ends steer.
    """

    def __init__(self, limit_rad: float, bicycle_share: float = 1.0) -> None:
        super().__init__()
        self.limit_rad = limit_rad
        self._bicycle_share = bicycle_share

    def clamped(self, command: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Softly clamped steering angle in rad."""
        return soft_clamp(command, self.limit_rad)

    def command_for(self, steer: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Command in rad whose clamped value is a steering angle, held just inside of the limit."""
        share = (steer / self.limit_rad).clamp(-COMMAND_SHARE, COMMAND_SHARE)
        return self.limit_rad * torch.atanh(share)

    def of_driver(self, steer: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Steering angle for the front wheel angle δ of a bicycle as long: tan δ = L κ, in rad."""
        if self._bicycle_share == 1.0:
            return self.angle_of_wheel(steer)
        return self.angle_of_wheel(torch.atan(self._bicycle_share * steer.tan()))

    def to_driver(self, steer: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Front wheel angle in rad of a bicycle as long on the same curve; undoes `of_driver`."""
        wheel = self.wheel_angle(steer)
        if self._bicycle_share == 1.0:
            return wheel
        return torch.atan(wheel.tan() / self._bicycle_share)

    def wheel_angle(self, steer: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Angle in rad of the wheel that the command tells: the command itself by default."""
        return steer

    def angle_of_wheel(self, wheel: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Steering angle in rad that turns this wheel so far; undoes `wheel_angle`."""
        return wheel

    @property
    @abstractmethod
    def gains(self) -> list[float]:
        """Angle of each wheel per angle of the command, for small angles."""

    @abstractmethod
    def angle_for(self, tangent: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Steering angle in rad for a value of the linear theory, exact for the kinematics."""

    @abstractmethod
    def forward(self, steer: Float[Tensor, " n"], length_scale: Float[Tensor, ""]) -> Directions:
        """Directions of all wheels for a clamped angle in rad and a factor on all lengths."""


class Ackermann(WheelSteering):
    """δ_i = atan2(X_i sin δ, L cos δ - y_i sin δ): every steered wheel is square to its own radius.

    X_i is the distance of a wheel ahead of the axle that does not steer, L > 0 that of the steered
    wheel farthest from it: wheels behind that axle turn against the command, so that the vehicle
    turns to the left under a positive one. Scaling all lengths leaves the wheels of a single track
    unchanged.
    """

    def __init__(self, wheels: Sequence[WheelSpec], limit_rad: float) -> None:
        origin = turning_axle_m(wheels)
        ahead = [(w.x_m - origin) if w.steered else 0.0 for w in wheels]
        length = max(map(abs, ahead))
        super().__init__(limit_rad, length / steered_length_m(wheels))
        self._gains = [distance / length for distance in ahead]
        steered = [float(w.steered) for w in wheels]
        side = [w.y_m / length if w.steered else 0.0 for w in wheels]
        self.register_exact("fixed", [[1 - flag] for flag in steered])
        self.register_exact("steered", [[flag] for flag in steered])
        self.register_exact("side", [[value] for value in side])
        self.register_exact("gain", [[gain] for gain in self._gains])
        self._single_track = not any(side) and set(map(abs, self._gains)) <= {0.0, 1.0}

    @property
    def gains(self) -> list[float]:
        """Angle of each wheel per angle of the command."""
        return self._gains

    def angle_for(self, tangent: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Return atan of the linear angle: tan δ = L κ."""
        return torch.atan(tangent)

    def forward(self, steer: Float[Tensor, " n"], length_scale: Float[Tensor, ""]) -> Directions:
        """Directions of all wheels."""
        sine, cosine = steer.sin(), steer.cos()
        across = self.get_buffer("gain") * sine
        along = torch.addcmul(self.get_buffer("fixed"), self.get_buffer("steered"), cosine)
        if self._single_track:
            return Directions(across, along)
        along = along - self.get_buffer("side") * (sine / length_scale)
        scale = (across.square() + along.square()).rsqrt()
        return Directions(across * scale, along * scale)


class Trucks(WheelSteering):
    """δ_i = ±gain · lean · sin(pivot): the rider's lean turns the trucks against each other."""

    def __init__(
        self, wheels: Sequence[WheelSpec], limit_rad: float, trucks: TruckSteering
    ) -> None:
        super().__init__(limit_rad, 1 / len({w.truck for w in wheels if w.truck}))
        self._gain = trucks.gain * math.sin(trucks.pivot_rad)
        self._gains = [self._gain * w.truck for w in wheels]
        self.register_exact("gain", [[gain] for gain in self._gains])

    @property
    def gains(self) -> list[float]:
        """Angle of each wheel per angle of lean."""
        return self._gains

    def angle_for(self, tangent: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Lean whose trucks turn by the atan of the linear angle."""
        return self.angle_of_wheel(torch.atan(self._gain * tangent))

    def wheel_angle(self, steer: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Angle of the trucks in rad under a lean."""
        return self._gain * steer

    def angle_of_wheel(self, wheel: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Lean in rad that turns the trucks so far."""
        return wheel / self._gain

    def forward(self, steer: Float[Tensor, " n"], length_scale: Float[Tensor, ""]) -> Directions:
        """Directions of all wheels."""
        angle = self.get_buffer("gain") * steer
        return Directions(angle.sin(), angle.cos())


class Straight(WheelSteering):
    """No wheel turns; the command is a virtual angle for the driven wheels."""

    def __init__(self, wheels: Sequence[WheelSpec], limit_rad: float) -> None:
        super().__init__(limit_rad)
        self._count = len(wheels)
        self.register_exact("ahead", [[1.0]] * self._count)
        self.register_exact("aside", [[0.0]] * self._count)

    @property
    def gains(self) -> list[float]:
        """No wheel follows the command."""
        return [0.0] * self._count

    def angle_for(self, tangent: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Return atan of the linear angle."""
        return torch.atan(tangent)

    def forward(self, steer: Float[Tensor, " n"], length_scale: Float[Tensor, ""]) -> Directions:
        """Directions of all wheels: straight ahead."""
        return Directions(self.get_buffer("aside"), self.get_buffer("ahead"))


def build_steering(
    steering: Steering, wheels: Sequence[WheelSpec], limit_rad: float
) -> WheelSteering:
    """Build the steering of the rolling wheels after its kind."""
    match steering:
        case AckermannSteering():
            return Ackermann(wheels, limit_rad)
        case TruckSteering():
            return Trucks(wheels, limit_rad, steering)
        case DifferentialDrive():
            return Straight(wheels, limit_rad)
