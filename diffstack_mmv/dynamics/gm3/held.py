"""The dynamics under one held command: what depends on it alone is computed once per step."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.body import LinearEquation
from diffstack_mmv.dynamics.gm3.chassis import Chassis, Contact, Physics
from diffstack_mmv.dynamics.gm3.drive import Command
from diffstack_mmv.dynamics.gm3.lean import (
    Lean,
    LeanCoefficients,
    lean_acceleration,
    lean_coefficients,
)


@dataclass(frozen=True)
class HeldDynamics:
    """x' = f(x) for a command that does not change.

    Args:
        chassis: The vehicle.
        physics: Its physical parameters.
        command: The command.
        axes: Directions of the wheels' axes under that command.
    """

    chassis: Chassis
    physics: Physics
    command: Command
    axes: Float[Tensor, "*b 2 3 wheels"]

    @property
    def leans(self) -> bool:
        """Whether the lean moves."""
        return self.chassis.spec.leans

    def velocity_equation(
        self, velocity: Float[Tensor, "*b 3"], lean: Float[Tensor, "*b 1"]
    ) -> LinearEquation:
        """V' = A v + b with the secants at this velocity (v_x, v_y, r) and lean."""
        return self.chassis.velocity_equation(velocity, lean, self.axes, self.command, self.physics)

    def contact(self, velocity: Float[Tensor, "*b 3"], lean: Float[Tensor, "*b 1"]) -> Contact:
        """Slips, loads and secants of the wheels."""
        return self.chassis.contact(velocity, lean, self.axes, self.command, self.physics)

    def lean_coefficients(self, lean: Float[Tensor, "*b 1"]) -> LeanCoefficients:
        """Secant coefficients of the lean equation."""
        spec = self.chassis.spec
        return lean_coefficients(
            lean,
            spec.mass_kg * spec.height_m,
            self.physics.roll_inertia,
            self.physics.roll_damping,
        )

    def derivative(self, state: Float[Tensor, "*b 8"]) -> Float[Tensor, "*b 8"]:
        """Right-hand side, in the order of the state."""
        _, velocity, heading, lean = unpack(state)
        rate = self.velocity_equation(velocity, lean.angle).rate(velocity)
        cosine, sine = heading.cos(), heading.sin()
        forward, left, yaw_rate = velocity.split(1, -1)
        zero = torch.zeros_like(heading)
        roll = Lean(zero, zero)
        if self.leans:
            coefficients = self.lean_coefficients(lean.angle)
            acceleration = lean_acceleration(lean, forward * yaw_rate, coefficients)
            roll = Lean(lean.rate, acceleration)
        east, north = cosine * forward - sine * left, sine * forward + cosine * left
        return torch.cat([east, north, rate[..., :2], yaw_rate, rate[..., 2:], *roll], -1)


def unpack(
    state: Float[Tensor, "*b 8"],
) -> tuple[Float[Tensor, "*b 2"], Float[Tensor, "*b 3"], Float[Tensor, "*b 1"], Lean]:
    """Position (m), velocity (v_x, v_y, r), heading (rad) and lean of a state."""
    position, linear, heading, yaw_rate, lean, lean_rate = state.split([2, 2, 1, 1, 1, 1], -1)
    return position, torch.cat([linear, yaw_rate], -1), heading, Lean(lean, lean_rate)
