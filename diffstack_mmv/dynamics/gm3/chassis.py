"""The vehicle under its tyres: from velocity, lean and command to forces, and to v' = A v + b."""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.body import LinearEquation, outer_sum
from diffstack_mmv.dynamics.gm3.contact import Contact, Grip
from diffstack_mmv.dynamics.gm3.drive import (
    AccelerationDrive,
    Command,
    DifferentialYawDrive,
    Drive,
    Rolling,
)
from diffstack_mmv.dynamics.gm3.lean import LeanLaw, PrescribedLean, camber_spin
from diffstack_mmv.dynamics.gm3.load import AccelerationLimits, LoadTransfer
from diffstack_mmv.dynamics.gm3.slip import (
    WheelAxes,
    hub_velocity,
    inverse_speed,
    slip_angle_ratio,
    wheel_axes,
)
from diffstack_mmv.dynamics.gm3.steering import Directions, build_steering
from diffstack_mmv.dynamics.gm3.tire import Tire, TireSlip, loaded_tire
from diffstack_mmv.smooth import limiter_gain
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import DifferentialDrive, ExactBuffers, VehicleSpec


class Physics(NamedTuple):
    """Physical parameters of one call, and what follows from them alone."""

    friction: Float[Tensor, "all 1"]  # μ, of all wheels
    rolling_friction: Float[Tensor, "wheels 1"]  # μ, of the wheels that are no casters
    cornering: Float[Tensor, "wheels 1"]  # C / 3 in N
    contact_half_length: Float[Tensor, "wheels 1"]  # ℓ in m
    inverse_inertia: Float[Tensor, "3 1"]  # 1/m, 1/m, 1/I_z
    yaw_inertia: Float[Tensor, ""]
    roll_inertia: Float[Tensor, ""]
    roll_damping: Float[Tensor, ""]
    aligning_gain: Float[Tensor, ""]
    damping_rate: Float[Tensor, ""]  # d_yaw
    damping: Float[Tensor, "3 3 1"]  # -d_yaw in its place
    rolling_resistance: Float[Tensor, ""]
    drag: Float[Tensor, ""]
    length_scale: Float[Tensor, ""]
    limits: AccelerationLimits


class Chassis(ExactBuffers):
    """Wheels, loads, steering and drive of a vehicle, joined.

    Args:
        spec: The vehicle.
        tire: The tyre law of all wheels.
        drive: How commands become slips, None for the vehicle's own way from accelerations.
        lean: How a leaning vehicle leans, `PrescribedLean()` by default.
    """

    def __init__(
        self,
        spec: VehicleSpec,
        tire: Tire,
        drive: type[Drive] | None = None,
        lean: LeanLaw | None = None,
    ) -> None:
        super().__init__()
        self.spec = spec
        self.tire = tire
        self.lean = lean or PrescribedLean()
        self.rolling = [i for i, wheel in enumerate(spec.wheels) if not wheel.caster]
        self.has_casters = len(self.rolling) < len(spec.wheels)
        wheels = [spec.wheels[index] for index in self.rolling]
        self.steering = build_steering(spec.steering, wheels, spec.limits.steer_max_rad)
        self.drive = drive(spec, self.rolling) if drive else _default_drive(spec, self.rolling)
        self.loads = LoadTransfer(spec, self.drive.braking)
        self.register_buffer("rolling_index", torch.tensor(self.rolling), persistent=False)
        per_wheel = {
            "x": [wheel.x_m for wheel in wheels],
            "y": [wheel.y_m for wheel in wheels],
            "radius": [wheel.radius_m for wheel in wheels],
            "camber_gain": [(1 - wheel.camber_reduction) / wheel.radius_m for wheel in wheels],
        }
        for name, values in per_wheel.items():
            self.register_exact(name, [[value] for value in values])
        driven = [index for index, wheel in enumerate(wheels) if wheel.driven]
        chosen = [[float(row == column) for column in driven] for row in range(len(wheels))]
        self.register_exact("driven_wheels", chosen)
        self.register_exact("axis_x", [[1.0], [0.0], [0.0]])
        self.register_exact("axis_yaw", [[0.0], [0.0], [1.0]])
        self.register_exact("steer_gain", [[gain] for gain in self.steering.gains])
        self.register_exact("inverse_mass", [[1 / spec.mass_kg], [1 / spec.mass_kg], [0.0]])
        self.register_exact("yaw_only", _matrix((2, 2, 1.0)))
        self.register_exact("turning", _matrix((0, 1, 1.0), (1, 0, -1.0)))
        resistance = [spec.parameters[name] for name in ("rolling_resistance", "drag")]
        self._resists = any(high > 0 for entry in resistance for _, _, high in entry.entries())

    def rolling_wheels(self, values: Float[Tensor, "all n"]) -> Float[Tensor, "wheels n"]:
        """Pick the wheels that are no casters."""
        if not self.has_casters:
            return values
        # not index_select: whole numbers among the inputs have no form in the generated libraries
        return torch.cat([values[index : index + 1] for index in self.rolling])

    def physics(self, values: Mapping[str, Tensor]) -> Physics:
        """Gather physical parameters in their units, by the names of `vehicles`."""
        friction = values["friction"].unsqueeze(-1)
        length = self.rolling_wheels(values["contact_half_length"].unsqueeze(-1))
        stiffness = self.rolling_wheels(values["tread_stiffness"].unsqueeze(-1))
        yaw_inertia, damping = values["yaw_inertia"], values["yaw_damping"]
        inverse = self.get_buffer("inverse_mass") + self.get_buffer("axis_yaw") / yaw_inertia
        return Physics(
            friction=friction,
            rolling_friction=self.rolling_wheels(friction),
            cornering=2 / 3 * stiffness * length.square(),
            contact_half_length=length,
            inverse_inertia=inverse,
            yaw_inertia=yaw_inertia,
            roll_inertia=values["roll_inertia"],
            roll_damping=values["roll_damping"],
            aligning_gain=values["aligning_gain"],
            damping_rate=damping,
            damping=-damping * self.get_buffer("yaw_only"),
            rolling_resistance=values["rolling_resistance"],
            drag=values["drag"],
            length_scale=values["length_scale"],
            limits=self.loads.limits(friction, values["length_scale"]),
        )

    def axes(self, directions: Directions, length_scale: Float[Tensor, ""]) -> WheelAxes:
        """Generalised directions of the wheels' axes."""
        x = self.get_buffer("x") * length_scale
        return wheel_axes(x, self.get_buffer("y"), directions.sine, directions.cosine)

    def normal_loads(
        self, velocity: Float[Tensor, "3 n"], command: Command, physics: Physics
    ) -> Float[Tensor, "all n"]:
        """Loads in N: a_x = A S(a_eff / A) within friction and lift, a_y = v_x r."""
        forward, yaw_rate = velocity[0], velocity[2]
        limits = physics.limits
        wanted = self.drive.acceleration(command, forward, physics.cornering)
        limit = torch.where(wanted > 0, limits.drive, limits.brake)
        acceleration = wanted * limiter_gain(wanted / limit)
        return self.loads(acceleration, forward * yaw_rate, limits, physics.length_scale)

    def grip(
        self,
        velocity: Float[Tensor, "3 n"],
        lean: Float[Tensor, " n"],
        axes: WheelAxes,
        command: Command,
        physics: Physics,
    ) -> Grip:
        """Loads, traction and camber of the rolling wheels."""
        slip_speed = self.spec.smoothing.slip_speed_mps
        hub = hub_velocity(axes, velocity)
        loads = self.normal_loads(velocity, command, physics)
        tire = loaded_tire(
            self.rolling_wheels(loads),
            physics.rolling_friction,
            physics.cornering,
            physics.contact_half_length,
        )
        rolling = Rolling(velocity, axes, hub, tire)
        traction = self.drive(command, rolling, physics.yaw_inertia)
        camber = None
        if self.spec.leans:
            limit = self.spec.limits.lean_max_rad
            camber = hub.forward * camber_spin(lean, limit, self.get_buffer("camber_gain"))
        trail_sign = hub.forward * (hub.forward.square() + slip_speed**2).rsqrt()
        inverse = inverse_speed(hub.forward, slip_speed)
        return Grip(loads, tire, traction, inverse, camber, trail_sign)

    def contact(self, velocity: Float[Tensor, "3 n"], grip: Grip, axes: WheelAxes) -> Contact:
        """Slips and tyre secants of the rolling wheels at a velocity, under a given grip."""
        hub = hub_velocity(axes, velocity)
        turn = -velocity[2] if grip.camber is None else grip.camber - velocity[2]
        across = -hub.left / grip.traction.reference
        slip_speed = self.spec.smoothing.slip_speed_mps
        ratio = slip_angle_ratio(hub, slip_speed) if self.tire.uses_slip_angle else None
        angle = None if ratio is None else -hub.left * ratio
        slip = TireSlip(grip.traction.slip, across, grip.inverse_speed * turn, angle)
        return Contact(grip, slip, ratio, self.tire.secants_in_vehicle(slip, grip.tire))

    def velocity_equation(
        self,
        velocity: Float[Tensor, "3 n"],
        contact: Contact,
        axes: WheelAxes,
        physics: Physics,
    ) -> LinearEquation:
        """A and b of v' = A v + b, with the secants of a contact."""
        secants, grip, traction = contact.secants, contact.grip, contact.grip.traction
        push = secants.along * traction.gain
        stiffness = secants.across / traction.reference
        if secants.per_angle is not None and contact.angle_ratio is not None:
            stiffness = stiffness + secants.per_angle * contact.angle_ratio
        lateral = stiffness * axes.across
        axis_yaw = self.get_buffer("axis_yaw")
        offset = (axes.along * (push * traction.constant)).sum(1)
        if secants.per_spin is not None:
            turn = secants.per_spin * grip.inverse_speed
            lateral = torch.addcmul(lateral, turn, axis_yaw.unsqueeze(-1))
            if grip.camber is not None:
                offset = offset + (axes.across * (turn * grip.camber)).sum(1)
        aligning = secants.aligning * grip.trail_sign / traction.reference
        moment = physics.aligning_gain * (axes.across * aligning).sum(1)
        matrix = outer_sum(axes.along, push * traction.row) - outer_sum(axes.across, lateral)
        matrix = torch.addcmul(matrix, moment, axis_yaw.unsqueeze(-1))
        matrix = torch.addcmul(physics.damping, matrix, physics.inverse_inertia.unsqueeze(1))
        matrix = torch.addcmul(matrix, velocity[2], self.get_buffer("turning"))
        if self._resists:
            matrix = matrix - self._resistance(velocity, physics)
        return LinearEquation(matrix, offset * physics.inverse_inertia)

    def _resistance(
        self, velocity: Float[Tensor, "3 n"], physics: Physics
    ) -> Float[Tensor, "3 3 n"]:
        """Rolling resistance c_r g and drag c_d |v_x| v_x / m, per v_x in 1/s."""
        smoothing = self.spec.smoothing
        size = (velocity[0].square() + smoothing.stop_speed_mps**2).sqrt()
        per_speed = GRAVITY * physics.rolling_resistance / size
        per_speed = per_speed + physics.drag / self.spec.mass_kg * size
        axis = self.get_buffer("axis_x")
        return per_speed * (axis.unsqueeze(1) * axis)


def _matrix(*entries: tuple[int, int, float]) -> list[list[list[float]]]:
    """A constant 3x3 matrix, zero but for some entries, with a last dimension for the batch."""
    matrix = [[[0.0] for _ in range(3)] for _ in range(3)]
    for row, column, value in entries:
        matrix[row][column][0] = value
    return matrix


def _default_drive(spec: VehicleSpec, rolling: list[int]) -> Drive:
    if isinstance(spec.steering, DifferentialDrive):
        return DifferentialYawDrive(spec, rolling, spec.steering)
    return AccelerationDrive(spec, rolling)
