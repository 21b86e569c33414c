"""Drive and brake: from an acceleration command, or a wheel speed, to the slip of every wheel.

An acceleration becomes a force demand per wheel, and the demand becomes a slip by the inverse of
the brush law, so that in straight running the force is the demand: gain 1 at every speed, no
memory. GM3 itself takes wheel speeds (`SpeedDrive`).
"""

from abc import abstractmethod
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message
from diffstack_mmv.dynamics.gm3.slip import (
    WheelAxes,
    WheelVelocity,
    reference_speed,
    rolling_speed,
)
from diffstack_mmv.dynamics.gm3.tire import TireProperties
from diffstack_mmv.smooth import limiter_gain
from diffstack_mmv.vehicles import DifferentialDrive, ExactBuffers, VehicleSpec

SLIP_LIMIT = 0.9  # of the commanded slip
ROUNDED_SHARE = 0.01  # of the friction: where the frozen gain of a step is rounded


class DriveSplit(NamedTuple):
    """An acceleration command in m/s², split into its driving and its braking part."""

    drive: Float[Tensor, "*b"]
    brake: Float[Tensor, "*b"]


class Command(NamedTuple):
    """What the rider asks for, held over a step: kept apart from what depends on the state."""

    split: DriveSplit
    steer: Float[Tensor, " n"]  # steering angle after the soft clamp, rad
    wheel_speed: Float[Tensor, "wheels n"] | None  # R Ω in m/s, for a `SpeedDrive`


class Rolling(NamedTuple):
    """How the wheels meet the ground at one instant."""

    velocity: Float[Tensor, "3 n"]  # v_x, v_y in m/s, r in rad/s
    axes: WheelAxes
    hub: WheelVelocity
    tire: TireProperties


class Traction(NamedTuple):
    """Longitudinal state of the wheels, with the force as k · gain · (constant + row · v)."""

    slip: Float[Tensor, "wheels n"]  # σ_x
    rolling: Float[Tensor, "wheels n"]  # V_r in m/s
    reference: Float[Tensor, "wheels n"]  # D in m/s
    gain: Float[Tensor, "wheels n"]
    constant: Float[Tensor, "wheels n"]
    row: Float[Tensor, "3 wheels n"]


def split_acceleration(acceleration: Float[Tensor, "*b"], width: float) -> DriveSplit:
    """Split a in m/s² smoothly: a_drive + a_brake = a, slope 1/2 each at zero, width a_ε."""
    size = (acceleration.square() + width**2).sqrt() - width
    return DriveSplit(0.5 * (acceleration + size), 0.5 * (acceleration - size))


def slip_per_share(share: Float[Tensor, "*b"], friction_share: float) -> Float[Tensor, "*b"]:
    """Return ψσ / q of the inverse brush law for a share q = F / (μ F_z) of the friction.

        q_b = q_max S(q / q_max)
        c = (1 - |q_b|)^(1/3)
        ψσ = sgn(q_b) (1 - c)
        ψσ / q_b = 1 / (1 + c + c²)

    The last line is finite at q = 0.
    """
    gain = limiter_gain(share / friction_share)
    root = (1 - (share * gain).abs()).pow(1 / 3)
    return gain / (1 + root + root.square())


def kink_of_gain(share: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The part |q| / 9 of ψσ / q near q = 0, without a smooth rest: it vanishes away from there.

    It does no harm to ψσ itself. A step that freezes ψσ / q and moves on in q has a kink by it,
    where the solutions of an optimisation come to lie and have no derivative.
    """
    square = share.square()
    return (share.abs() - square * (square + ROUNDED_SHARE**2).rsqrt()) / 9


class Drive(ExactBuffers):
    """How commands become slips.

    Args:
        spec: The vehicle.
        rolling: Indices of the wheels that are no casters.
    """

    braking: ClassVar[str] = "braked"
    """Which wheels brake: those with a brake, or the driven ones."""

    def __init__(self, spec: VehicleSpec, rolling: list[int]) -> None:
        super().__init__()
        self.spec = spec
        wheels = [spec.wheels[index] for index in rolling]
        self.register_exact("driven", [[float(wheel.driven)] for wheel in wheels])
        self.register_exact("braked", [[float(wheel.braked)] for wheel in wheels])
        self.register_exact("axis_x", [[[1.0]], [[0.0]], [[0.0]]])
        self.register_exact("axis_yaw", [[[0.0]], [[0.0]], [[1.0]]])

    @abstractmethod
    def acceleration(
        self,
        command: Command,
        forward: Float[Tensor, " n"],
        cornering: Float[Tensor, "wheels 1"],
    ) -> Float[Tensor, " n"]:
        """Acceleration in m/s² that is asked for, before any limit of friction.

        `forward` is v_x in m/s, `cornering` C / 3 of the wheels in N.
        """

    @abstractmethod
    def forward(
        self, command: Command, rolling: Rolling, yaw_inertia: Float[Tensor, ""]
    ) -> Traction:
        """Slips and force demands of the wheels."""


class AccelerationDrive(Drive):
    """Force demand m a μF_z / Σ μF_z on the driven wheels, or on the braked ones if a < 0.

    Brakes fade out at standstill, a_eff = a_drive + a_brake v_x / sqrt(v_x² + v_stop²), and never
    push backwards. A vehicle that can reverse takes a as it is, and drives wherever a and v_x have
    the same sign.
    """

    def _fade(
        self, command: Command, forward: Float[Tensor, " n"]
    ) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
        """Constant part of a_eff in m/s² and its part per v_x in 1/s."""
        if self.spec.reverse:
            whole = command.split.drive + command.split.brake
            return whole, torch.zeros_like(forward)
        stop = self.spec.smoothing.stop_speed_mps
        return command.split.drive, command.split.brake * (forward.square() + stop**2).rsqrt()

    def acceleration(
        self,
        command: Command,
        forward: Float[Tensor, " n"],
        cornering: Float[Tensor, "wheels 1"],
    ) -> Float[Tensor, " n"]:
        """a_eff in m/s²."""
        constant, per_speed = self._fade(command, forward)
        return torch.addcmul(constant, per_speed, forward)

    def _shares(
        self, command: Command, rolling: Rolling
    ) -> tuple[Float[Tensor, "wheels n"], Float[Tensor, "wheels n"], Float[Tensor, "wheels n"]]:
        """Demand per wheel in N: constant, per v_x, and q of the wheels of the set."""
        forward = rolling.velocity[0]
        constant, per_speed = self._fade(command, forward)
        wanted = torch.addcmul(constant, per_speed, forward)
        driving = wanted * forward >= 0 if self.spec.reverse else wanted > 0
        members = torch.where(driving, self.get_buffer("driven"), self.get_buffer("braked"))
        grip = members * rolling.tire.grip
        per_grip = self.spec.mass_kg / grip.sum(0)
        shares = grip * per_grip
        return shares * constant, shares * per_speed, per_grip * wanted * members

    def forward(
        self, command: Command, rolling: Rolling, yaw_inertia: Float[Tensor, ""]
    ) -> Traction:
        """Slips and force demands of the wheels."""
        constant, per_speed, share = self._shares(command, rolling)
        row = per_speed * self.get_buffer("axis_x")
        return self._traction(share, constant, row, rolling)

    def _traction(
        self,
        share: Float[Tensor, "wheels n"],
        constant: Float[Tensor, "wheels n"],
        row: Float[Tensor, "3 wheels n"],
        rolling: Rolling,
    ) -> Traction:
        smoothing, tire = self.spec.smoothing, rolling.tire
        inverse = slip_per_share(share, smoothing.friction_share)
        wanted = share * inverse * tire.onset
        limit = limiter_gain(wanted / SLIP_LIMIT)
        slip = wanted * limit
        speed = rolling_speed(rolling.hub.forward, slip, smoothing.slip_speed_mps)
        reference = reference_speed(speed, smoothing.slip_speed_mps)
        kink = kink_of_gain(share)
        rounded = inverse - kink
        # what the gain lacks stands beside it, so that the slip at this velocity is the same
        constant = constant + kink / rounded * share * tire.grip
        return Traction(slip, speed, reference, rounded * limit / tire.cornering, constant, row)


class DifferentialYawDrive(AccelerationDrive):
    """Driven wheels on both sides follow a commanded yaw rate by the difference of their forces.

    r_c = v_x tan(δ) / L,  M = I_z (r_c - r) / τ limited to what the weaker wheel's friction
    allows, and F_i = F_i - M y_i / Σ y².
    """

    def __init__(self, spec: VehicleSpec, rolling: list[int], drive: DifferentialDrive) -> None:
        super().__init__(spec, rolling)
        self.servo = drive
        sides = [spec.wheels[i].y_m * float(spec.wheels[i].driven) for i in rolling]
        self.register_exact("lever", [[side / sum(y**2 for y in sides)] for side in sides])
        self._reach = drive.yaw_share * sum(abs(side) for side in sides)
        self._count = sum(spec.wheels[i].driven for i in rolling)

    def _yaw_gain(self, moment: Float[Tensor, " n"], tire: TireProperties) -> Float[Tensor, " n"]:
        """Share of a moment in N m that the friction of the driven wheels lets through."""
        inverse = (self.get_buffer("driven") / tire.grip).sum(0)
        return limiter_gain(moment * inverse / (self._reach * self._count))

    def forward(
        self, command: Command, rolling: Rolling, yaw_inertia: Float[Tensor, ""]
    ) -> Traction:
        """Slips and force demands of the wheels."""
        tire, forward = rolling.tire, rolling.velocity[0]
        constant, per_speed, share = self._shares(command, rolling)
        per_rate = yaw_inertia / self.servo.yaw_time_constant_s
        curvature = command.steer.tan() / self.servo.virtual_wheelbase_m
        moment = per_rate * (curvature * forward - rolling.velocity[2])
        allowed = self._yaw_gain(moment, tire)
        lever = self.get_buffer("lever")
        share = share - moment * allowed * lever / tire.grip
        turning = per_rate * allowed * lever
        axis_x, axis_yaw = self.get_buffer("axis_x"), self.get_buffer("axis_yaw")
        row = per_speed * axis_x
        row = row + turning * (axis_yaw - curvature * axis_x)
        return self._traction(share, constant, row, rolling)


class SpeedDrive(Drive):
    """Driven wheels turn at given speeds, all others roll freely: the interface of GM3 itself.

    σ_x = (V_r - V_x) / D with V_r = R Ω held, so that F_x = (k / D) (V_r - g · v). A driven wheel
    that turns too slowly brakes, no other one does.
    """

    braking: ClassVar[str] = "driven"

    @staticmethod
    def _given(command: Command) -> Float[Tensor, "wheels n"]:
        if command.wheel_speed is None:
            raise ValueError(message("wheel_speed", "be given to this drive", "None"))
        return command.wheel_speed

    def acceleration(
        self,
        command: Command,
        forward: Float[Tensor, " n"],
        cornering: Float[Tensor, "wheels 1"],
    ) -> Float[Tensor, " n"]:
        """Acceleration in m/s² of the linear tyre C σ_x / m; `cornering` is C / 3 in N."""
        given = self._given(command)
        slip_speed = self.spec.smoothing.slip_speed_mps
        slip = (given - forward) / reference_speed(given, slip_speed)
        stiffness = self.get_buffer("driven") * cornering * (3 / self.spec.mass_kg)
        return (stiffness * slip).sum(0)

    def forward(
        self, command: Command, rolling: Rolling, yaw_inertia: Float[Tensor, ""]
    ) -> Traction:
        """Slips of the wheels at their given speeds."""
        driven, given = self.get_buffer("driven"), self._given(command)
        hub = rolling.hub
        speed = torch.where(driven > 0, given, hub.forward)
        reference = reference_speed(speed, self.spec.smoothing.slip_speed_mps)
        slip = (speed - hub.forward) / reference
        row = -rolling.axes.along * driven
        return Traction(slip, speed, reference, 1 / reference, driven * given, row)
