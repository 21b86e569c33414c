"""The single integrator, the dynamics of those who can step sideways."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.geometry import angle_of, left_of, rotate
from diffstack_mmv.smooth import saturate
from diffstack_mmv.types import Motion


class SingleIntegrator(DynamicsModel):
    """Point whose controls change its velocity, in a frame that does not turn.

        v⁺ = v + a dt,    p⁺ = p + v dt + a dt² / 2

    Written with accelerations as controls and not, as in Trajectron++, with velocities, so that
    zero control keeps the present velocity for pedestrians as it does for vehicles.

    Args:
        dt_s: Length of one step in s.
        acceleration_max_mps2: Largest acceleration per axis.

    Raises:
        ValueError: The acceleration is not positive.
    """

    class State(NamedTuple):
        """Position in m, velocity in m/s."""

        position_x: Float[Tensor, "*b"]
        position_y: Float[Tensor, "*b"]
        velocity_x: Float[Tensor, "*b"]
        velocity_y: Float[Tensor, "*b"]

    class Control(NamedTuple):
        """Acceleration in m/s²."""

        acceleration_x: Float[Tensor, "*b"]
        acceleration_y: Float[Tensor, "*b"]

    def __init__(self, dt_s: float = 0.1, acceleration_max_mps2: float = 4.0) -> None:
        require_positive("acceleration_max_mps2", acceleration_max_mps2)
        limits = (acceleration_max_mps2, acceleration_max_mps2)
        super().__init__(dt_s, (-limits[0], -limits[1]), limits)

    def step(
        self, state: Float[Tensor, "*b 4"], control: Float[Tensor, "*b 2"]
    ) -> Float[Tensor, "*b 4"]:
        """Advance by one control step."""
        acceleration = saturate(control, *self.bounds)
        position, velocity = state[..., :2], state[..., 2:]
        moved = position + self.dt_s * velocity + 0.5 * self.dt_s**2 * acceleration
        faster = velocity + self.dt_s * acceleration
        return torch.stack([*moved.unbind(-1), *faster.unbind(-1)], -1)

    def motion(self, states: Float[Tensor, "*b 4"], controls: Float[Tensor, "*b 2"]) -> Motion:
        """Motion whose heading is the course (rad); the point has no yaw rate of its own."""
        self._require_states("states", states)
        velocity = states[..., 2:]
        # the course at rest is zero, and so is its gradient
        course = angle_of(velocity, velocity.square().sum(-1) > 0)
        return Motion(states[..., :2], course, rotate(velocity, -course), torch.zeros_like(course))

    def initial_state(self, motion: Motion) -> Float[Tensor, "*b 4"]:
        """Take position (m) and velocity (m/s), turned into the fixed frame."""
        return torch.cat([motion.position, rotate(motion.velocity, motion.heading)], -1)

    def control_for(
        self,
        state: Float[Tensor, "*#b 4"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b 2"]:
        """Acceleration (m/s²) along the course, and v² κ across it."""
        velocity = state[..., 2:]
        speed = velocity.square().sum(-1).add(1e-12).sqrt()
        forward = velocity / speed.unsqueeze(-1)
        left = left_of(forward)
        across = curvature * speed.square()
        return self.within_bounds(
            acceleration.unsqueeze(-1) * forward + across.unsqueeze(-1) * left
        )
