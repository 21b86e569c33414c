"""The dynamically extended unicycle, the ego model of DiffStack."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.records import DriverInput
from diffstack_mmv.geometry import rotate
from diffstack_mmv.smooth import saturate, sinc, sinc_slope
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import VehicleSpec, require_vehicle, turning_axle_m


class ExtendedUnicycle(DynamicsModel):
    """Point with heading and speed, driven by yaw rate and acceleration.

    Exact for constant ω and a over one step, with φ = ω dt / 2, v_m = v + a dt / 2 and θ_m = θ + φ:

        p⁺ = p + R(θ_m) (v_m dt sin φ / φ,  ½ a dt² (sin φ - φ cos φ) / φ²)
        θ⁺ = θ + ω dt,   v⁺ = v + a dt

    written by sin φ / φ and its slope, which are smooth through ω = 0. Commands beyond the limits
    of the vehicle saturate smoothly; inside they act unchanged. Source: Karkus et al., DiffStack
    (CoRL 2022), with the integral in closed form.

    Args:
        spec: The vehicle: limits, and axle and wheelbase for a driver who steers by an angle.
        dt_s: Length of one step in s.

    Raises:
        TypeError: `spec` is no vehicle.
        ValueError: The step is not positive.
    """

    class State(NamedTuple):
        """Position in m, heading in rad, speed in m/s."""

        position_x: Float[Tensor, "*b"]
        position_y: Float[Tensor, "*b"]
        heading: Float[Tensor, "*b"]
        speed: Float[Tensor, "*b"]

    class Control(NamedTuple):
        """Yaw rate in rad/s, acceleration in m/s²."""

        yaw_rate: Float[Tensor, "*b"]
        acceleration: Float[Tensor, "*b"]

    def __init__(self, spec: VehicleSpec, dt_s: float = 0.1) -> None:
        require_vehicle(spec)
        limits = spec.limits
        yaw_rate = limits.yaw_rate_max_radps
        super().__init__(
            dt_s,
            (-yaw_rate, limits.acceleration_min_mps2),
            (yaw_rate, limits.acceleration_max_mps2),
        )
        self._axle_m = turning_axle_m(spec.wheels)
        self._wheelbase_m = spec.wheelbase.entries()[0][0]

    @property
    def reference_ahead_m(self) -> float:
        """Longitudinal position in m of the axle that does not steer: it slips no sideways."""
        return self._axle_m

    @property
    def can_reverse(self) -> bool:
        """It can: its speed has no floor."""
        return True

    def step(
        self, state: Float[Tensor, "*b 4"], control: Float[Tensor, "*b 2"]
    ) -> Float[Tensor, "*b 4"]:
        """Advance by one control step."""
        dt_s = self.dt_s
        yaw_rate, acceleration = saturate(control, *self.bounds).unbind(-1)
        heading, speed = state[..., 2], state[..., 3]
        half_turn = 0.5 * dt_s * yaw_rate
        chord = torch.stack(
            [
                dt_s * (speed + 0.5 * dt_s * acceleration) * sinc(half_turn),
                0.5 * dt_s**2 * acceleration * sinc_slope(half_turn),
            ],
            -1,
        )
        position = state[..., :2] + rotate(chord, heading + half_turn)
        turned, faster = heading + dt_s * yaw_rate, speed + dt_s * acceleration
        return torch.stack([*position.unbind(-1), turned, faster], -1)

    def motion(self, states: Float[Tensor, "*b 4"], controls: Float[Tensor, "*b 2"]) -> Motion:
        """Motion of the point itself."""
        self._require_states("states", states)
        speed = states[..., 3]
        return Motion(
            position=states[..., :2],
            heading=states[..., 2],
            velocity=torch.stack([speed, torch.zeros_like(speed)], -1),
            yaw_rate=saturate(controls, *self.bounds)[..., 0],
        )

    def initial_state(self, motion: Motion) -> Float[Tensor, "*b 4"]:
        """Take pose and forward speed; the yaw rate is a control, not a state."""
        return torch.cat(
            [motion.position, motion.heading.unsqueeze(-1), motion.velocity[..., :1]], -1
        )

    def control_for(
        self,
        state: Float[Tensor, "*#b 4"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b 2"]:
        """Yaw rate v κ at the middle of the step, acceleration (m/s²) as it is."""
        speed = state[..., 3] + 0.5 * self.dt_s * acceleration
        pair = torch.broadcast_tensors(curvature * speed, acceleration)
        return self.within_bounds(torch.stack(pair, -1))

    def control_for_driver(
        self, state: Float[Tensor, "*b 4"], driver: DriverInput
    ) -> Float[Tensor, "*b 2"]:
        """Yaw rate v tan δ / L in rad/s of the kinematic bicycle at the middle of the step.

        The curve is that of the angle in reverse, too.
        """
        speed = state[..., 3] + 0.5 * self.dt_s * driver.acceleration
        yaw_rate = speed * driver.steer.tan() / self._wheelbase_m
        return torch.stack([yaw_rate, driver.acceleration.expand_as(yaw_rate)], -1)

    def driver_input(
        self, state: Float[Tensor, "*b 4"], control: Float[Tensor, "*b 2"]
    ) -> DriverInput:
        """Acceleration (m/s²), and the angle (rad) of the same curve; straight at standstill."""
        yaw_rate, acceleration = control.unbind(-1)
        speed = state[..., 3] + 0.5 * self.dt_s * acceleration
        moving = speed != 0
        curvature = yaw_rate / torch.where(moving, speed, torch.ones_like(speed))
        curvature = torch.where(moving, curvature, torch.zeros_like(curvature))
        return DriverInput(acceleration, torch.atan(self._wheelbase_m * curvature))
