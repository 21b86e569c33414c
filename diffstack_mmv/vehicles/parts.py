"""The parts of a vehicle: wheels, steering, limits, footprint, smoothing widths."""

import math
from dataclasses import dataclass

from dmmv_conventions.checks import (
    require,
    require_between,
    require_positive,
    require_switch,
)

WHEEL_PARAMETERS = {"friction": "1", "tread_stiffness": "N/m^2", "contact_half_length": "m"}
BODY_PARAMETERS = {
    "yaw_inertia": "kg m^2",
    "roll_inertia": "kg m^2",
    "aligning_gain": "1",
    "yaw_damping": "1/s",
    "roll_damping": "N m s",
    "length_scale": "1",
    "rolling_resistance": "1",
    "drag": "N s^2/m^2",
}


FASTEST_TURN_RADPS = 20.0
"""Three turns per second; a yaw rate beyond is one in degrees."""


@dataclass(frozen=True)
class WheelSpec:
    """One wheel.

    Args:
        name: Name, e.g. "front" or "rear_left".
        x_m: Position ahead of the centre of gravity.
        y_m: Position to the left of the centre of gravity.
        radius_m: Radius of the tyre.
        steered: Turned by the steering command (Ackermann).
        truck: 1 on the front truck of a skateboard, -1 on the rear truck, else 0.
        driven: Carries driving force.
        braked: Carries braking force.
        caster: Swivels freely and only carries load.
        camber_reduction: ε_γ, the share of the camber spin that the carcass takes away, 0 for a
            round tyre.

    Raises:
        ValueError: A number is impossible, a caster is steered, driven or braked, or the name could
            not stand in the name of a control.
    """

    name: str
    x_m: float
    y_m: float
    radius_m: float
    steered: bool = False
    truck: int = 0
    driven: bool = False
    braked: bool = False
    caster: bool = False
    camber_reduction: float = 0.0

    def __post_init__(self) -> None:
        where = f"for wheel '{self.name}'"
        require(
            f"_{self.name}".isidentifier(),
            "name",
            "consist of letters, digits and underscores",
            repr(self.name),
            remedy="Write rear_left, for example: controls are named after wheels.",
        )
        require(math.isfinite(self.x_m), "x_m", "be finite", self.x_m, where)
        require(math.isfinite(self.y_m), "y_m", "be finite", self.y_m, where)
        require_positive("radius_m", self.radius_m, where)
        for flag in ("steered", "driven", "braked", "caster"):
            require_switch(flag, getattr(self, flag), where)
        require(
            self.truck in (-1, 0, 1),
            "truck",
            "be 1 (front), -1 (rear) or 0 (none)",
            self.truck,
            where,
        )
        require_between("camber_reduction", self.camber_reduction, 0.0, 1.0, where)
        free = not (self.steered or self.driven or self.braked or self.truck)
        require(
            free or not self.caster,
            "caster",
            "be neither steered, driven nor braked",
            "a caster that is",
            where,
        )


@dataclass(frozen=True)
class Limits:
    """What the vehicle can do at most.

    Args:
        speed_max_mps: Largest speed a plan may ask for.
        acceleration_min_mps2: Strongest braking, negative.
        acceleration_max_mps2: Strongest acceleration.
        steer_max_rad: Limit of the steering command's soft clamp; for a truck the rider's lean,
            for a differential drive a virtual angle.
        yaw_rate_max_radps: Largest yaw rate a plan may ask for.
        lean_max_rad: Limit of the lean's soft clamp in the tyre's camber, 0 where the vehicle does
            not lean.

    Raises:
        ValueError: A limit has the wrong sign or an angle is not in radians.
    """

    speed_max_mps: float
    acceleration_min_mps2: float
    acceleration_max_mps2: float
    steer_max_rad: float
    yaw_rate_max_radps: float
    lean_max_rad: float = 0.0

    def __post_init__(self) -> None:
        require_positive("limits.speed_max_mps", self.speed_max_mps)
        require_positive("limits.acceleration_max_mps2", self.acceleration_max_mps2)
        rate, remedy = self.yaw_rate_max_radps, "Give radians per second."
        require_between("limits.yaw_rate_max_radps", rate, 0.0, FASTEST_TURN_RADPS, remedy=remedy)
        require_positive("limits.yaw_rate_max_radps", rate)
        braking = self.acceleration_min_mps2
        require(
            -math.inf < braking < 0,
            "limits.acceleration_min_mps2",
            "be negative and finite",
            braking,
            remedy="Braking counts negative.",
        )
        right_angle = math.pi / 2
        steer, lean = self.steer_max_rad, self.lean_max_rad
        advice = "Give radians."
        require(
            0 < steer < right_angle, "limits.steer_max_rad", "lie in (0, π/2)", steer, remedy=advice
        )
        require(
            0 <= lean < right_angle, "limits.lean_max_rad", "lie in [0, π/2)", lean, remedy=advice
        )

    @property
    def acceleration_mps2(self) -> tuple[float, float]:
        """Strongest braking and acceleration in m/s²."""
        return self.acceleration_min_mps2, self.acceleration_max_mps2


@dataclass(frozen=True)
class FootprintSpec:
    """Outline seen from above: length along the heading, and width.

    Raises:
        ValueError: A side is not positive.
    """

    length_m: float
    width_m: float

    def __post_init__(self) -> None:
        require_positive("footprint.length_m", self.length_m)
        require_positive("footprint.width_m", self.width_m)


@dataclass(frozen=True)
class Smoothing:
    """Widths of the smooth transitions of the GM3 equations.

    Args:
        slip_speed_mps: v_ε, regularises the slip at standstill.
        stop_speed_mps: v_stop, below which the brakes fade out.
        acceleration_mps2: a_ε, rounds the split of a command into drive and brake.
        friction_share: q_max, usable share of the longitudinal friction.

    Raises:
        ValueError: A width is not positive or the share is not below 1.
    """

    slip_speed_mps: float = 0.3
    stop_speed_mps: float = 0.2
    acceleration_mps2: float = 0.01
    friction_share: float = 0.98

    def __post_init__(self) -> None:
        require_positive("smoothing.slip_speed_mps", self.slip_speed_mps)
        require_positive("smoothing.stop_speed_mps", self.stop_speed_mps)
        require_positive("smoothing.acceleration_mps2", self.acceleration_mps2)
        share = self.friction_share
        require(
            0 < share < 1,
            "smoothing.friction_share",
            "lie in (0, 1)",
            share,
            remedy="0.98 is usual.",
        )


@dataclass(frozen=True)
class AckermannSteering:
    """Every steered wheel points along its own circle around one centre on the unsteered axle."""


@dataclass(frozen=True)
class TruckSteering:
    """Skateboard trucks turn with the rider's lean: δ = gain · lean · sin(pivot).

    Raises:
        ValueError: The gain is not positive, or the pivot is none between 0 and π/2 in radians.
    """

    gain: float
    pivot_rad: float

    def __post_init__(self) -> None:
        remedy = "Without it no lean turns the trucks."
        require_positive("steering.gain", self.gain, remedy=remedy)
        require_positive("steering.pivot_rad", self.pivot_rad, remedy=remedy)
        require_between(
            "steering.pivot_rad", self.pivot_rad, 0.0, math.pi / 2, remedy="Give radians."
        )


@dataclass(frozen=True)
class DifferentialDrive:
    """Driven wheels turn the vehicle by the difference of their forces.

    Args:
        virtual_wheelbase_m: L of the commanded yaw rate v tan(δ) / L.
        yaw_time_constant_s: Time constant of the yaw servo.
        yaw_share: Share of the weaker wheel's friction that the servo may use.

    Raises:
        ValueError: A number is not positive, or the share is above 1.
    """

    virtual_wheelbase_m: float
    yaw_time_constant_s: float
    yaw_share: float

    def __post_init__(self) -> None:
        require_positive("steering.virtual_wheelbase_m", self.virtual_wheelbase_m)
        require_positive("steering.yaw_time_constant_s", self.yaw_time_constant_s)
        require_between("steering.yaw_share", self.yaw_share, 0.01, 1.0)


Steering = AckermannSteering | TruckSteering | DifferentialDrive
