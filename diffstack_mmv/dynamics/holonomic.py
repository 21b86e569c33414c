"""A point that takes any velocity at once, the robot of CrowdNav and its successors."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.geometry import angle_of, direction, rotate
from diffstack_mmv.smooth import safe_norm, smooth_maximum
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import VehicleSpec, require_vehicle

ROUNDING = 0.01
"""Of the corner at the top speed, as a share of it."""
FACING_MPS = 0.05
"""Below about this speed the point keeps facing where it did."""
REST_MPS = 1e-3
"""Speeds are rounded at rest over this."""


class Holonomic(DynamicsModel):
    """Point that takes a velocity at once, in any direction, up to its top speed.

        p⁺ = p + w dt,    w = u v_max / max(|u|, v_max)
        θ⁺ = the direction of w + ε (cos θ, sin θ),    v⁺ = |w|

    with a rounded maximum. It faces where it goes, within ε = 0.05 m/s, and keeps facing there at
    rest. Exact for any step. Source: the holonomic kinematics of CrowdNav (Chen et al., ICRA 2019),
    DS-RNN and CrowdNav++, whose actions are cut to the top speed as well.

    Args:
        spec: The vehicle: its top speed v_max counts, nothing else.
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
        """Velocity in m/s, in world directions."""

        velocity_x: Float[Tensor, "*b"]
        velocity_y: Float[Tensor, "*b"]

    def __init__(self, spec: VehicleSpec, dt_s: float = 0.1) -> None:
        require_vehicle(spec)
        self.speed_max_mps = spec.limits.speed_max_mps
        super().__init__(dt_s, (-self.speed_max_mps,) * 2, (self.speed_max_mps,) * 2)

    @property
    def keeps_top_speed(self) -> bool:
        """It does: a command beyond is cut."""
        return True

    def step(
        self, state: Float[Tensor, "*b 4"], control: Float[Tensor, "*b 2"]
    ) -> Float[Tensor, "*b 4"]:
        """Advance by one control step."""
        velocity = self._taken(control)
        position = state[..., :2] + self.dt_s * velocity
        heading = state[..., 2] + torch.zeros_like(velocity[..., 0])
        ahead, left = rotate(velocity, -heading).unbind(-1)
        ahead = ahead + FACING_MPS
        # exactly backwards at this speed it faces nowhere: it keeps its heading
        nowhere = ahead.square() + left.square() == 0
        turned = heading + torch.atan2(left, torch.where(nowhere, torch.ones_like(ahead), ahead))
        speed = safe_norm(velocity, REST_MPS**2) - REST_MPS
        return torch.stack([*position.unbind(-1), turned, speed], -1)

    def motion(self, states: Float[Tensor, "*b 4"], controls: Float[Tensor, "*b 2"]) -> Motion:
        """Motion of the point; it turns at once, so it tells no yaw rate (rad/s)."""
        self._require_states("states", states)
        speed = states[..., 3]
        zero = torch.zeros_like(speed)
        return Motion(states[..., :2], states[..., 2], torch.stack([speed, zero], -1), zero)

    def initial_state(self, motion: Motion) -> Float[Tensor, "*b 4"]:
        """Take position (m) and speed (m/s), facing the course."""
        square = motion.velocity.square().sum(-1)
        # at rest there is no course, and neither it nor the speed has a slope
        moving = square > 0
        course = angle_of(motion.velocity, moving)
        speed = torch.where(moving, torch.where(moving, square, 1.0).sqrt(), 0.0)
        return torch.stack([*motion.position.unbind(-1), motion.heading + course, speed], -1)

    def control_for(
        self,
        state: Float[Tensor, "*#b 4"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b 2"]:
        """Velocity (m/s) after such a step: faster by a dt, turned by κ v dt at its mean speed."""
        before = state[..., 3]
        speed = (before + self.dt_s * acceleration).clamp(0, self.speed_max_mps)
        turn = self.dt_s * curvature * 0.5 * (before + speed)
        velocity = speed.unsqueeze(-1) * direction(state[..., 2] + turn)
        return self.within_bounds(velocity)

    def _taken(self, control: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b 2"]:
        """The velocity that a command leads to, in m/s."""
        top = self.speed_max_mps
        asked = safe_norm(control, REST_MPS**2)
        fastest = smooth_maximum(asked, torch.full_like(asked, top), ROUNDING * top)
        return control * (top / fastest).unsqueeze(-1)
