"""DiffGM3 with wheel speeds as controls, the interface of GM3 itself."""

from collections import namedtuple
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.drive import Command, Drive, SpeedDrive, split_acceleration
from diffstack_mmv.dynamics.gm3.model import COMMAND_RANGE, ControlRange, DiffGM3
from diffstack_mmv.dynamics.gm3.slip import reference_speed
from diffstack_mmv.dynamics.records import DriverInput
from diffstack_mmv.vehicles import DifferentialDrive, VehicleSpec

PROBE = 0.05  # m/s and rad/s by which the answer of a step to its wheel speeds is told
LEAST_ANSWER = 0.1  # of a wheel speed; sliding wheels answer less, and more speed helps them little
YAW_RATE_COLUMN = DiffGM3.State._fields.index("yaw_rate")


def _driven(spec: VehicleSpec) -> list[int]:
    return [index for index, wheel in enumerate(spec.wheels) if wheel.driven]


class DiffGM3WheelSpeed(DiffGM3):
    """DiffGM3 under u = (Ω of each driven wheel in rad/s, steering command in rad).

    Driven wheels turn at the given speeds whatever the forces, all others roll freely; a driven
    wheel that turns too slowly brakes. The controls are named after the wheels of the vehicle, e.g.
    `wheel_speed_rear`. Arguments are those of `DiffGM3`. Source: GM3, Table II.
    """

    drive: ClassVar[type[Drive] | None] = SpeedDrive

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the record of the controls, which no module has by its name."""
        return {name: value for name, value in self.__dict__.items() if name != "Control"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what `__getstate__` told, and name the controls anew."""
        super().__setstate__(state)
        self.Control = self.control_record(self.spec)

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
        state: Float[Tensor, "*#b 8"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b m"]:
        """Control that gives an acceleration (m/s²) and a curvature (1/m) over the coming step.

        Wheel speeds hold still while the hubs catch up with them, so no speed holds an acceleration
        for longer than a step. Wanted at the end of the step are v* = v + a dt and, where driven
        wheels do the steering, r* = κ v*. The hub speeds of that turn are tried, and corrected once
        by what one step of the model misses, over its answer to a change of all wheel speeds:

            Ω_i R_i = v* - κ v* y_i + (v* - v₁) / (∂v₁/∂v) - y_i (r* - r₁) / (∂r₁/∂r)

        Answers are central differences, held above a tenth. Steered wheels are set as in `DiffGM3`:
        for the steady turn, which the course reaches after its side slip has settled.
        """
        steer = self.steer_for(state, curvature)
        speed, acceleration, curvature = torch.broadcast_tensors(
            state[..., 2], acceleration, curvature
        )
        forward = speed + acceleration * self.dt_s
        wanted = torch.stack([forward, curvature * forward], -1)
        turn = torch.cat([wanted @ self._turns(), steer.unsqueeze(-1)], -1)
        return self.within_bounds(turn + self._missed(state, turn, wanted))

    @property
    def driver_input_needs_state(self) -> bool:
        """A wheel speed means another acceleration at every speed."""
        return True

    def control_for_driver(
        self, state: Float[Tensor, "*b 8"], driver: DriverInput
    ) -> Float[Tensor, "*b m"]:
        """Wheel speeds for an acceleration (m/s²) by linear tyres, and the steering command.

        The acceleration is that of this instant; it fades as the hubs catch up with the wheels.
        """
        steer, acceleration = torch.broadcast_tensors(driver.steer, driver.acceleration)
        speeds = self._wheel_speeds(self._hub_speed(state), acceleration)
        steering = self.chassis.steering
        command = steering.command_for(steering.of_driver(steer))
        return torch.cat([speeds, command.unsqueeze(-1)], -1)

    def driver_input(
        self, state: Float[Tensor, "*b 8"], control: Float[Tensor, "*b m"]
    ) -> DriverInput:
        """Mean acceleration (m/s²) of the linear tyres, and the steering angle (rad)."""
        hub = self._hub_speed(state)
        reference = reference_speed(hub, self.spec.smoothing.slip_speed_mps)
        slip = (control[..., :-1] * self._of_driven("radius") - hub) / reference
        acceleration = slip.mean(-1) * self._stiffness() / self.spec.mass_kg
        steering = self.chassis.steering
        return DriverInput(acceleration, steering.to_driver(steering.clamped(control[..., -1])))

    def _turns(self) -> Float[Tensor, "2 driven"]:
        """Speeds in rad/s of the driven wheels per forward speed (m/s) and yaw rate (rad/s)."""
        side = self._of_driven("y")
        return torch.stack([torch.ones_like(side), -side]) / self._of_driven("radius")

    def _missed(
        self,
        state: Float[Tensor, "*#b 8"],
        control: Float[Tensor, "*b m"],
        wanted: Float[Tensor, "*b 2"],
    ) -> Float[Tensor, "*b m"]:
        """What a control lacks for a forward speed (m/s) and yaw rate (rad/s) after one step."""
        columns = [2, YAW_RATE_COLUMN]
        if not isinstance(self.spec.steering, DifferentialDrive):
            columns, wanted = columns[:1], wanted[..., :1]
        turns = torch.nn.functional.pad(self._turns()[: len(columns)], (0, 1))
        tried = torch.cat([torch.zeros_like(turns[:1]), PROBE * turns, -PROBE * turns])
        ends = self.step(state.unsqueeze(-2), control.unsqueeze(-2) + tried)[..., columns]
        more, less = ends[..., 1:, :].chunk(2, -2)
        answer = (more - less).diagonal(dim1=-2, dim2=-1) / (2 * PROBE)
        return ((wanted - ends[..., 0, :]) / answer.clamp(min=LEAST_ANSWER)) @ turns

    def _of_driven(self, name: str) -> Float[Tensor, " driven"]:
        """A number of the driven wheels, SI units."""
        return self.chassis.get_buffer("driven_wheels").mT @ self.chassis.get_buffer(name)[:, 0]

    def _stiffness(self) -> Float[Tensor, ""]:
        """ΣC of the driven wheels in N."""
        stiffness = 3 * self.physics().cornering.squeeze(-1)
        return (self.chassis.get_buffer("driven_wheels").mT @ stiffness).sum()

    def _hub_speed(self, state: Float[Tensor, "*b 8"]) -> Float[Tensor, "*b driven"]:
        """Forward speed in m/s of the hubs of the driven wheels."""
        return state[..., 2:3] - state[..., 5:6] * self._of_driven("y")

    def _wheel_speeds(
        self, hub: Float[Tensor, "*b driven"], acceleration: Float[Tensor, "*b"]
    ) -> Float[Tensor, "*b driven"]:
        """Speeds in rad/s whose slips give an acceleration in m/s² on linear tyres."""
        slip = (self.spec.mass_kg * acceleration / self._stiffness()).unsqueeze(-1)
        spread = slip * reference_speed(hub, self.spec.smoothing.slip_speed_mps)
        return (hub + spread) / self._of_driven("radius")
