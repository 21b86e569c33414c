"""DiffKBM: the kinematic bicycle with a learnable wheelbase."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.records import AccelerationRange, DerivedQuantity, DriverInput
from diffstack_mmv.geometry import direction
from diffstack_mmv.smooth import floor_at_zero, saturate
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import SoftClamped, VehicleSpec, require_vehicle, turning_axle_m

EULER_STEP_S = 0.05
"""Longest step of the Euler scheme within a plan."""


class SoftplusFloor:
    """Smooth v ≥ 0: w softplus(v / w), at most w ln 2 above the ReLU.

    A vehicle at rest creeps under no acceleration, the faster the shorter the step: by 0.37 m in
    3 s with the default width and steps of 0.1 s, 0.71 m with 0.01 s. Every smooth floor that
    keeps its slope does so: one that is zero at rest and never below has its minimum there.

    Args:
        width_mps: w in m/s.

    Raises:
        ValueError: The width is not positive.
    """

    def __init__(self, width_mps: float = 0.05) -> None:
        require_positive("width_mps", width_mps)
        self.width_mps = width_mps

    def __repr__(self) -> str:
        return f"SoftplusFloor(width_mps={self.width_mps})"

    def __call__(self, speed: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Bound a speed in m/s from below by zero."""
        return self.width_mps * torch.nn.functional.softplus(speed / self.width_mps)


class ReversingFloor:
    """v ≥ -r with its right-hand derivative at -r: a vehicle that is driven or pushed backwards.

    Args:
        reverse_mps: r in m/s.

    Raises:
        ValueError: The speed is not positive.
    """

    def __init__(self, reverse_mps: float = 1.0) -> None:
        require_positive("reverse_mps", reverse_mps)
        self.reverse_mps = reverse_mps

    def __repr__(self) -> str:
        return f"ReversingFloor(reverse_mps={self.reverse_mps})"

    def __call__(self, speed: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Bound a speed in m/s from below by -r."""
        return floor_at_zero(speed + self.reverse_mps) - self.reverse_mps


class DiffKBM(DynamicsModel):
    """Kinematic bicycle, reference point at the axle that does not steer, one Euler step.

        v⁺ = max(v + a dt, 0)
        θ⁺ = θ + (v⁺ / L) tan δ dt
        p⁺ = p + v (cos θ, sin θ) dt

    with the OLD speed and heading in the position. Commands inside the limits act unchanged, beyond
    them they saturate smoothly. Source: Cai et al., DMMV, Sec. IV-A. The wheelbase L is learnable.

    Args:
        spec: The vehicle: wheelbase and limits.
        dt_s: Length of one step in s.
        floor: How the speed is kept from going negative: the ReLU with its right-hand derivative at
            zero, a `SoftplusFloor`, whose gradient never vanishes, or a `ReversingFloor`. By
            default the ReLU, or a `ReversingFloor` at the top speed of a vehicle with
            `reverse: true`.

    Raises:
        TypeError: `spec` is no vehicle.
        ValueError: The step is not positive.
    """

    class State(NamedTuple):
        """Position of the rear axle in m, heading in rad, speed in m/s."""

        position_x: Float[Tensor, "*b"]
        position_y: Float[Tensor, "*b"]
        heading: Float[Tensor, "*b"]
        speed: Float[Tensor, "*b"]

    class Control(NamedTuple):
        """Acceleration in m/s², steering angle in rad."""

        acceleration: Float[Tensor, "*b"]
        steer: Float[Tensor, "*b"]

    def __init__(
        self,
        spec: VehicleSpec,
        dt_s: float = 0.1,
        floor: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        require_vehicle(spec)
        limits = spec.limits
        super().__init__(
            dt_s,
            (limits.acceleration_min_mps2, -limits.steer_max_rad),
            (limits.acceleration_max_mps2, limits.steer_max_rad),
        )
        self.wheelbase = SoftClamped(spec.wheelbase)
        self.floor = floor or _floor_of(spec)
        self._axle_m = turning_axle_m(spec.wheels)

    @property
    def reference_ahead_m(self) -> float:
        """Longitudinal position in m of the axle that does not steer, mostly the rear one."""
        return self._axle_m

    @property
    def longest_step_s(self) -> float:
        """Longest step in s of the Euler scheme within a plan."""
        return EULER_STEP_S

    @property
    def acts_a_step_late(self) -> bool:
        """It does: the position moves with the old speed and heading."""
        return True

    @property
    def can_reverse(self) -> bool:
        """It can with a `ReversingFloor`."""
        return isinstance(self.floor, ReversingFloor)

    def step(
        self, state: Float[Tensor, "*b 4"], control: Float[Tensor, "*b 2"]
    ) -> Float[Tensor, "*b 4"]:
        """Advance by one control step."""
        acceleration, steer = saturate(control, *self.bounds).unbind(-1)
        heading, speed = state[..., 2], state[..., 3]
        next_speed = self.floor(speed + self.dt_s * acceleration)
        next_heading = heading + self.dt_s * next_speed / self.wheelbase() * steer.tan()
        position = state[..., :2] + self.dt_s * speed.unsqueeze(-1) * direction(heading)
        return torch.stack([*position.unbind(-1), next_heading, next_speed], -1)

    def motion(self, states: Float[Tensor, "*b 4"], controls: Float[Tensor, "*b 2"]) -> Motion:
        """Motion of the rear axle, which has no lateral velocity; yaw rate v tan δ / L in rad/s."""
        self._require_states("states", states)
        speed = states[..., 3]
        steer = saturate(controls, *self.bounds)[..., 1]
        return Motion(
            position=states[..., :2],
            heading=states[..., 2],
            velocity=torch.stack([speed, torch.zeros_like(speed)], -1),
            yaw_rate=speed / self.wheelbase() * steer.tan(),
        )

    def initial_state(self, motion: Motion) -> Float[Tensor, "*b 4"]:
        """Take pose and forward speed (m/s), floored at zero where the model cannot reverse."""
        speed = motion.velocity[..., :1]
        speed = self.floor(speed) if self.can_reverse else speed.clamp_min(0)
        return torch.cat([motion.position, motion.heading.unsqueeze(-1), speed], -1)

    def control_for(
        self,
        state: Float[Tensor, "*#b 4"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b 2"]:
        """Steering angle atan(L κ) in rad, acceleration (m/s²) as it is."""
        steer = torch.atan(self.wheelbase() * curvature)
        _, *pair = torch.broadcast_tensors(state[..., 3], acceleration, steer)
        return self.within_bounds(torch.stack(pair, -1))

    def useful_acceleration(self, state: Float[Tensor, "*b 4"]) -> AccelerationRange | None:
        """At least what ends at a sharp floor, in m/s²; a smooth one is never reached."""
        if self.floor is floor_at_zero:
            lowest = 0.0
        elif isinstance(self.floor, ReversingFloor):
            lowest = -self.floor.reverse_mps
        else:
            return None
        least = (lowest - state[..., 3]) / self.dt_s
        return AccelerationRange(least, torch.full_like(least, torch.inf))

    @property
    def driver_input_needs_state(self) -> bool:
        """An acceleration and an angle mean the same at every state."""
        return False

    def control_for_driver(
        self, state: Float[Tensor, "*b 4"], driver: DriverInput
    ) -> Float[Tensor, "*b 2"]:
        """Acceleration (m/s²) and steering angle (rad) are the control."""
        return torch.stack(torch.broadcast_tensors(*driver), -1)

    def driver_input(
        self, state: Float[Tensor, "*b 4"], control: Float[Tensor, "*b 2"]
    ) -> DriverInput:
        """The control is acceleration (m/s²) and steering angle (rad)."""
        return DriverInput(*control.unbind(-1))

    def derived_quantities(self) -> Mapping[str, DerivedQuantity]:
        """Steering angle per curvature in m, which is the wheelbase."""
        return {"steer_per_curvature": DerivedQuantity(self.wheelbase(), "m")}

    def description(self) -> dict[str, Any]:
        """What a results file tells of the model, with the floor of the speed."""
        name = getattr(self.floor, "__name__", repr(self.floor))
        return super().description() | {"speed_floor": name}


def _floor_of(spec: VehicleSpec) -> Callable[[Tensor], Tensor]:
    """Floor of the speed that the vehicle itself asks for."""
    return ReversingFloor(spec.limits.speed_max_mps) if spec.reverse else floor_at_zero
