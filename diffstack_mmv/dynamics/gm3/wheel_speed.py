"""DiffGM3 with wheel speeds as controls, the interface of GM3 itself."""

from collections import namedtuple
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.drive import Command, Drive, SpeedDrive, split_acceleration
from diffstack_mmv.dynamics.gm3.model import COMMAND_RANGE, ControlRange, DiffGM3
from diffstack_mmv.dynamics.gm3.slip import reference_speed
from diffstack_mmv.vehicles import VehicleSpec


def _driven(spec: VehicleSpec) -> list[int]:
    return [index for index, wheel in enumerate(spec.wheels) if wheel.driven]


class DiffGM3WheelSpeed(DiffGM3):
    """DiffGM3 under u = (Ω of each driven wheel in rad/s, steering command in rad).

    Driven wheels turn at the given speeds whatever the forces, all others roll freely; a driven
    wheel that turns too slowly brakes. The controls are named after the wheels of the vehicle, e.g.
    `wheel_speed_rear`. Arguments are those of `DiffGM3`. Source: GM3, Table II.
    """

    drive: ClassVar[type[Drive] | None] = SpeedDrive

    @classmethod
    def control_record(cls, spec: VehicleSpec) -> Any:
        """Named tuple with one wheel speed per driven wheel, and the steering command."""
        names = [f"wheel_speed_{spec.wheels[index].name}" for index in _driven(spec)]
        return namedtuple("Control", [*names, "steer"])

    @classmethod
    def control_range(cls, spec: VehicleSpec) -> ControlRange:
        """Wheel speeds from rest to the speed limit, backwards as well for a reversing vehicle."""
        limits = spec.limits
        fastest = [limits.speed_max_mps / spec.wheels[index].radius_m for index in _driven(spec)]
        slowest = [-speed if spec.reverse else 0.0 for speed in fastest]
        steer = COMMAND_RANGE * limits.steer_max_rad
        return ControlRange([*slowest, -steer], [*fastest, steer])

    def command(self, control: Float[Tensor, "m n"]) -> Command:
        """What a control asks for."""
        speeds, steer = control[:-1], control[-1]
        driven = self.chassis.get_buffer("driven_wheels").unsqueeze(-1)
        circumferential = self.chassis.get_buffer("radius") * (driven * speeds).sum(1)
        idle = split_acceleration(torch.zeros_like(steer), self.spec.smoothing.acceleration_mps2)
        return Command(idle, self.chassis.steering.clamped(steer), circumferential)

    def control_for(
        self,
        state: Float[Tensor, "*b 8"],
        acceleration: Float[Tensor, "*b"],
        curvature: Float[Tensor, "*b"],
    ) -> Float[Tensor, "*b m"]:
        """Control that holds an acceleration (m/s²) and a curvature (1/m), by linear tyres.

        Each driven wheel gets the speed of its hub on that curve, and the slip m a / ΣC on top.
        """
        steer = self.steer_for(state, curvature)
        speed, acceleration = torch.broadcast_tensors(state[..., 2], acceleration)
        driven = self.chassis.get_buffer("driven_wheels").mT
        stiffness = 3 * self.physics().cornering.squeeze(-1)
        slip = self.spec.mass_kg * acceleration / (driven @ stiffness).sum()
        side, radius = (
            driven @ self.chassis.get_buffer(name).squeeze(-1) for name in ("y", "radius")
        )
        hub = speed.unsqueeze(-1) * (1 - curvature.unsqueeze(-1) * side)
        spread = slip.unsqueeze(-1) * reference_speed(hub, self.spec.smoothing.slip_speed_mps)
        return self.within_bounds(torch.cat([(hub + spread) / radius, steer.unsqueeze(-1)], -1))
