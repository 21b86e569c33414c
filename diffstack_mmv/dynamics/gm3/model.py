"""DiffGM3: differentiable brush-tyre dynamics for any layout of wheels."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Self

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require_at_least, require_whole
from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.gm3.chassis import Chassis, Physics
from diffstack_mmv.dynamics.gm3.columns import side_by_side
from diffstack_mmv.dynamics.gm3.drive import Command, Drive, split_acceleration
from diffstack_mmv.dynamics.gm3.grip import within_grip
from diffstack_mmv.dynamics.gm3.lean import LeanLaw
from diffstack_mmv.dynamics.gm3.side_slip import body_motion
from diffstack_mmv.dynamics.gm3.steady import steer_command
from diffstack_mmv.dynamics.gm3.stepper import LIM2, Stepper
from diffstack_mmv.dynamics.gm3.tire import ConsistentBrush, Tire
from diffstack_mmv.dynamics.gm3.understeer import axle_quantities, steer_per_curvature
from diffstack_mmv.dynamics.gm3.wheel_forces import forces_at_wheels
from diffstack_mmv.dynamics.gm3.zero_order_hold import ZeroOrderHoldDynamics
from diffstack_mmv.dynamics.records import DerivedQuantity, DriverInput, WheelForces
from diffstack_mmv.types import GRAVITY, Motion
from diffstack_mmv.vehicles import (
    BODY_PARAMETERS,
    WHEEL_PARAMETERS,
    DifferentialDrive,
    SoftClamped,
    VehicleSpec,
    require_vehicle,
    turning_axle_m,
)

COMMAND_RANGE = 2.0  # steering commands may go that far beyond the soft limit: tanh(2) = 0.96
COMMAND_LIMIT = 1e3  # m/s^2, far beyond friction; keeps powers of a wild command finite


class ControlRange(NamedTuple):
    """Lower and upper ends of the box of admissible controls, SI units."""

    lower: list[float]
    upper: list[float]


class DiffGM3(DynamicsModel):
    """Wheels on brush tyres under a rigid, possibly leaning body, seen from its centre of gravity.

    Per wheel: hub velocity → slip and spin → tyre law → force in the body's axes. Body:

        m (v_x' - r v_y) = ΣF_x
        m (v_y' + r v_x) = ΣF_y
        I_z r' = ΣM - I_z d_yaw r

    Loads follow a_x and the lateral acceleration v_x r without memory; an acceleration command
    becomes wheel slips by the inverse brush law; the steering command is softly clamped. All wheels
    and all elements of a batch are computed at once.

    Source:
        Cai et al., GM3 (arXiv 2510.07807), and DMMV, Sec. III and IV-B; every difference from the
        printed equations is listed in docs/dynamics.md.

    Args:
        spec: The vehicle: wheels, masses, parameters with ranges.
        dt_s: Length of one control step in s.
        tire: Tyre law of all wheels, `ConsistentBrush()` by default.
        substeps: Steps of the numerical method per control step.
        stepper: Numerical method, `LIM2()` by default.
        lean: How a leaning vehicle leans, `PrescribedLean()` by default.

    Raises:
        ValueError: The step or the number of substeps is not positive, or a wheel would carry no
            load.
        TypeError: Tyre law, method or lean law is none, such as the name or the class of one.
    """

    drive: ClassVar[type[Drive] | None] = None  # the vehicle's own way from accelerations

    class State(NamedTuple):
        """Pose of the centre of gravity (m, rad), body velocity (m/s), yaw rate, lean, its rate."""

        position_x: Float[Tensor, "*b"]
        position_y: Float[Tensor, "*b"]
        velocity_forward: Float[Tensor, "*b"]
        velocity_left: Float[Tensor, "*b"]
        heading: Float[Tensor, "*b"]
        yaw_rate: Float[Tensor, "*b"]
        lean: Float[Tensor, "*b"]
        lean_rate: Float[Tensor, "*b"]

    class Control(NamedTuple):
        """Acceleration in m/s², steering command in rad (before the soft clamp)."""

        acceleration: Float[Tensor, "*b"]
        steer: Float[Tensor, "*b"]

    def __init__(
        self,
        spec: VehicleSpec,
        dt_s: float = 0.1,
        tire: Tire | None = None,
        substeps: int = 1,
        stepper: Stepper | None = None,
        lean: LeanLaw | None = None,
    ) -> None:
        require_vehicle(spec)
        _require_parts(tire=tire, stepper=stepper, lean=lean)
        require_whole("substeps", substeps)
        require_at_least("substeps", substeps, 1)
        self.Control = self.control_record(spec)
        super().__init__(dt_s, *self.control_range(spec))
        self.spec = spec
        self.substeps = substeps
        self.stepper = stepper or LIM2()
        self.chassis = Chassis(spec, tire or ConsistentBrush(), self.drive, lean)
        for name in WHEEL_PARAMETERS:
            self.add_module(name, SoftClamped(spec.wheel_parameter(name)))
        for name in BODY_PARAMETERS:
            self.add_module(name, SoftClamped(spec.parameters[name]))
        self._turning_axle_m = turning_axle_m(spec.wheels)

    @classmethod
    def control_record(cls, spec: VehicleSpec) -> Any:
        """Named tuple of the controls of a vehicle."""
        return cls.Control

    @classmethod
    def control_range(cls, spec: VehicleSpec) -> ControlRange:
        """Box of admissible controls of a vehicle."""
        limits = spec.limits
        steer = COMMAND_RANGE * limits.steer_max_rad
        return ControlRange(
            [limits.acceleration_min_mps2, -steer], [limits.acceleration_max_mps2, steer]
        )

    def physics(self) -> Physics:
        """Physical parameters of this model, ready for use."""
        names = [*WHEEL_PARAMETERS, *BODY_PARAMETERS]
        return self.chassis.physics({name: self.get_submodule(name)() for name in names})

    def command(self, control: Float[Tensor, "2 n"]) -> Command:
        """What a control asks for."""
        acceleration = control[0].clamp(-COMMAND_LIMIT, COMMAND_LIMIT)
        width = self.spec.smoothing.acceleration_mps2
        steer = self.chassis.steering.clamped(control[1])
        return Command(split_acceleration(acceleration, width), steer, None)

    def hold(self, control: Float[Tensor, "m n"]) -> ZeroOrderHoldDynamics:
        """Dynamics under one control, with all that depends on it alone computed."""
        physics, command = self.physics(), self.command(control)
        directions = self.chassis.steering(command.steer, physics.length_scale)
        axes = self.chassis.axes(directions, physics.length_scale)
        return ZeroOrderHoldDynamics(self.chassis, physics, command, axes)

    def derivative(
        self, state: Float[Tensor, "*#b 8"], control: Float[Tensor, "*#b m"]
    ) -> Float[Tensor, "*b 8"]:
        """Continuous-time right-hand side x' = f(x, u), SI units per second.

        Raises:
            ValueError: As `forward` does.
        """
        columns = side_by_side(*self._fitting(state, control))
        return columns.as_rows(self.hold(columns.control).derivative(columns.state))

    def step(
        self, state: Float[Tensor, "*#b 8"], control: Float[Tensor, "*#b m"]
    ) -> Float[Tensor, "*b 8"]:
        """Advance by one control step."""
        columns = side_by_side(state, control)
        held, reached = self.hold(columns.control), columns.state
        for _ in range(self.substeps):
            reached = self.stepper(held, reached, self.dt_s / self.substeps)
        return columns.as_rows(reached)

    def motion(self, states: Float[Tensor, "*b 8"], controls: Float[Tensor, "*b m"]) -> Motion:
        """Motion of the centre of gravity; it does not depend on the controls."""
        self._require_states("states", states)
        return Motion(states[..., :2], states[..., 4], states[..., 2:4], states[..., 5])

    def initial_state(self, motion: Motion) -> Float[Tensor, "*b 8"]:
        """State with this pose and velocity, leaning as in a steady turn: γ = atan(v_x r / g)."""
        lateral = motion.velocity[..., 0] * motion.yaw_rate
        lean = torch.atan(lateral / GRAVITY) if self.spec.leans else torch.zeros_like(lateral)
        rest = torch.stack([motion.heading, motion.yaw_rate, lean, torch.zeros_like(lean)], -1)
        return torch.cat([motion.position, motion.velocity, rest], -1)

    def state_on_course(self, motion: Motion) -> Float[Tensor, "*b 8"]:
        """State of a vehicle whose centre of gravity was tracked: `motion.heading` is its course.

        See `side_slip` for the angle between them.
        """
        return self.initial_state(body_motion(motion, self._turning_axle_m))

    def control_for(
        self,
        state: Float[Tensor, "*#b 8"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b 2"]:
        """Control that holds an acceleration (m/s²) and a path curvature (1/m), by linear tyres.

        The steering angle is that of a steady turn with understeer, its tangent exact for the
        kinematics, sent through the inverse of the soft clamp. Wheels that turn the vehicle by the
        difference of their forces push it on besides, by 0.9 m/s² in the tightest turn of the
        wheelchair, which is taken off the acceleration.
        """
        pair = torch.broadcast_tensors(acceleration, self.steer_for(state, curvature))
        control = self.within_bounds(torch.stack(pair, -1))
        if not isinstance(self.spec.steering, DifferentialDrive):
            return control
        pushed = self.derivative(state, control)[..., 2] - control[..., 0]
        corrected = torch.stack([control[..., 0] - pushed, control[..., 1]], -1)
        return self.within_bounds(corrected)

    def curvature_within_grip(
        self,
        state: Float[Tensor, "*b 8"],
        acceleration: Float[Tensor, "*b"],
        curvature: Float[Tensor, "*b"],
    ) -> Float[Tensor, "*b"]:
        """What of a curvature (1/m) the tyres hold, see `within_grip`."""
        asked = acceleration.clamp(*self.spec.limits.acceleration_mps2)
        return within_grip(curvature, state[..., 2], asked, self.get_submodule("friction")())

    def steer_for(
        self, state: Float[Tensor, "*#b 8"], curvature: Float[Tensor, "*#b"]
    ) -> Float[Tensor, "*b"]:
        """Steering command in rad that holds a curvature in 1/m at the speed of a state."""
        return steer_command(self.chassis, self.physics(), state[..., 2], curvature)

    def lengthened(self, repeats: int) -> Self:
        """The model with so many steps as one, taken as substeps."""
        longer = super().lengthened(repeats)
        longer.substeps = self.substeps * repeats
        return longer

    @property
    def moves_with_pose(self) -> bool:
        """The road is flat and the same everywhere."""
        return True

    @property
    def can_reverse(self) -> bool:
        """It can where its vehicle may."""
        return self.spec.reverse

    @property
    def driver_input_needs_state(self) -> bool:
        """An acceleration and an angle mean the same at every state."""
        return False

    def control_for_driver(
        self, state: Float[Tensor, "*b 8"], driver: DriverInput
    ) -> Float[Tensor, "*b m"]:
        """Acceleration (m/s²), and the command for the curve of the driver's steering angle."""
        steering = self.chassis.steering
        steer = steering.command_for(steering.of_driver(driver.steer))
        return torch.stack(torch.broadcast_tensors(driver.acceleration, steer), -1)

    def driver_input(
        self, state: Float[Tensor, "*b 8"], control: Float[Tensor, "*b m"]
    ) -> DriverInput:
        """Acceleration (m/s²), and the driver's steering angle (rad) after the soft clamp."""
        steering = self.chassis.steering
        return DriverInput(control[..., 0], steering.to_driver(steering.clamped(control[..., 1])))

    def wheel_forces(
        self, state: Float[Tensor, "*b 8"], control: Float[Tensor, "*b m"]
    ) -> WheelForces:
        """Loads, slips and forces of all wheels under a state and a control."""
        columns = side_by_side(state, control)
        return forces_at_wheels(self.hold(columns.control), columns.state, columns.shape)

    def derived_quantities(self) -> Mapping[str, DerivedQuantity]:
        """Steering per curvature, normalised cornering stiffnesses C / F_z, understeer gradient.

        The steering angle per curvature at 5 m/s holds all that acts as understeer in one number:
        tyres, yaw damping and aligning moment. The others exist where both axles are tyred.
        """
        tread = self.get_submodule("tread_stiffness")()
        length = self.get_submodule("contact_half_length")()
        steer = steer_per_curvature(self.chassis, self.physics())
        return steer | axle_quantities(self.spec, tread, length)

    def description(self) -> dict[str, Any]:
        """What a results file tells of the model: tyre law with its numbers, and the scheme."""
        return super().description() | {
            "tyre_law": repr(self.chassis.tire),
            "substeps": self.substeps,
            "stepper": type(self.stepper).__name__,
            "lean": repr(self.chassis.lean) if self.spec.leans else None,
        }


_PARTS: dict[str, tuple[type, str, str]] = {
    "tire": (Tire, "a tyre law", "Give ConsistentBrush(), PaperBrush() or SharpBrush()."),
    "stepper": (Stepper, "a numerical method", "Give LIM2(), RungeKutta4() or ExplicitEuler()."),
    "lean": (LeanLaw, "a lean law", "Give PrescribedLean() or CoordinatedLean()."),
}
"""The parts that can be exchanged: their kind, what it is called, and what there is of it."""


def _require_parts(**parts: object) -> None:
    """Refuse the name or the class of a part in its place, at which the first step would break."""
    for argument, part in parts.items():
        kind, wanted, remedy = _PARTS[argument]
        if part is not None and (isinstance(part, type) or not isinstance(part, kind)):
            found = f"{type(part).__name__} {part!r}"
            raise TypeError(message(argument, f"be {wanted}", found, "", remedy))
