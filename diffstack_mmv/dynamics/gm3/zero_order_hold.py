"""Zero-order hold: dynamics under one command; what depends on it alone is computed once."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.body import LinearEquation
from diffstack_mmv.dynamics.gm3.chassis import Chassis, Physics
from diffstack_mmv.dynamics.gm3.contact import Contact, Grip
from diffstack_mmv.dynamics.gm3.drive import Command
from diffstack_mmv.dynamics.gm3.lean import (
    Lean,
    LeanCoefficients,
    RollBody,
    lean_acceleration,
)
from diffstack_mmv.dynamics.gm3.slip import WheelAxes


@dataclass(frozen=True)
class ZeroOrderHoldDynamics:
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
    axes: WheelAxes

    @property
    def leans(self) -> bool:
        """Whether the lean moves."""
        return self.chassis.spec.leans

    def contact(self, velocity: Float[Tensor, "3 n"], lean: Float[Tensor, " n"]) -> Contact:
        """Loads, slips and secants of the wheels at this velocity (v_x, v_y, r) and lean."""
        chassis, axes = self.chassis, self.axes
        grip = chassis.grip(velocity, lean, axes, self.command, self.physics)
        return chassis.contact(velocity, grip, axes)

    def slipping(self, velocity: Float[Tensor, "3 n"], grip: Grip) -> Contact:
        """Slips and secants at this velocity under loads and traction that are known."""
        return self.chassis.contact(velocity, grip, self.axes)

    def equation(self, velocity: Float[Tensor, "3 n"], contact: Contact) -> LinearEquation:
        """V' = A v + b with the secants of a contact at this velocity."""
        return self.chassis.velocity_equation(velocity, contact, self.axes, self.physics)

    def lean_coefficients(self, lean: Float[Tensor, " n"]) -> LeanCoefficients:
        """Secant coefficients of the lean equation."""
        spec, physics = self.chassis.spec, self.physics
        body = RollBody(spec.mass_kg * spec.height_m, physics.roll_inertia, physics.roll_damping)
        return self.chassis.lean.pendulum(body).secant(lean)

    def anticipated(
        self, lateral: Float[Tensor, " n"], change: Float[Tensor, " n"]
    ) -> Float[Tensor, " n"]:
        """Lateral acceleration (m/s²) that the lean answers, from it and its change (m/s³)."""
        lead_s = self.chassis.lean.lead_s
        return lateral + lead_s * change if lead_s else lateral

    def derivative(self, state: Float[Tensor, "8 n"]) -> Float[Tensor, "8 n"]:
        """Right-hand side, in the order of the state."""
        _, velocity, heading, lean = unpack(state)
        rate = self.equation(velocity, self.contact(velocity, lean.angle)).rate(velocity)
        forward, left, yaw_rate = velocity.unbind(0)
        roll = Lean(torch.zeros_like(heading), torch.zeros_like(heading))
        if self.leans:
            coefficients = self.lean_coefficients(lean.angle)
            change = rate[0] * yaw_rate + forward * rate[2]
            lateral = self.anticipated(forward * yaw_rate, change)
            acceleration = lean_acceleration(lean, lateral, coefficients)
            roll = Lean(lean.rate, acceleration)
        cosine, sine = heading.cos(), heading.sin()
        east, north = cosine * forward - sine * left, sine * forward + cosine * left
        return torch.stack([east, north, rate[0], rate[1], yaw_rate, rate[2], *roll])


class StateParts(NamedTuple):
    """The parts of a state: position (m), velocity (v_x, v_y, r), heading (rad), lean."""

    position: Float[Tensor, "2 n"]
    velocity: Float[Tensor, "3 n"]
    heading: Float[Tensor, " n"]
    lean: Lean


def unpack(state: Float[Tensor, "8 n"]) -> StateParts:
    """Take a state apart."""
    forward, left, heading, yaw_rate, lean, lean_rate = state[2:].unbind(0)
    velocity = torch.stack([forward, left, yaw_rate])
    return StateParts(state[:2], velocity, heading, Lean(lean, lean_rate))
