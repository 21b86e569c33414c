"""Vehicles of a benchmark: the one that drives, and the one its controller believes in."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require, require_multiple
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.dynamics.catalogue import ModelFactory, VehicleSpec, altered, model_of
from diffstack_mmv.simulation.collision import Footprint, RectangleFootprint
from diffstack_mmv.simulation.vehicle_robot import FINEST_NEEDED_S, Actuation, VehicleRobot
from diffstack_mmv.simulation.zero_order_hold import ZeroOrderHold

Actuate = Callable[[Float[Tensor, "*b m"]], Float[Tensor, "*b m"]]


@dataclass(frozen=True)
class SimulatedVehicle:
    """A vehicle under limits, on a road, in the eyes of one dynamics model.

    Attributes:
        vehicle: The vehicle as its YAML file describes it.
        dynamics: What builds its model, or the name of a file of `configs/dynamics`.
        limits: Largest speed and accelerations; the tighter of these and the vehicle's own hold.
        mass_factor: Scales the mass.
        friction: Friction coefficient of all tyres; the vehicle's own if None.
        name: Name of `dynamics` where it is no name itself.

    Raises:
        ValueError: A limit is missing, unknown or no finite number.
    """

    vehicle: Mapping[str, Any]
    dynamics: str | ModelFactory
    limits: Mapping[str, float]
    mass_factor: float = 1.0
    friction: float | None = None
    name: str = ""

    def __post_init__(self) -> None:
        wanted = ("speed_max_mps", "acceleration_min_mps2", "acceleration_max_mps2")
        complete = isinstance(self.limits, Mapping) and set(self.limits) == set(wanted)
        remedy = "Give these three and no other."
        require(complete, "limits", f"hold {', '.join(wanted)}", self.limits, "", remedy)
        for key, value in self.limits.items():
            number = isinstance(value, Real) and not isinstance(value, bool)
            # beside the vehicle's own, what is not a number would count as no limit
            finite = number and math.isfinite(value)
            require(finite, f"limits.{key}", "be a finite number", repr(value))

    @property
    def dynamics_name(self) -> str:
        """Name of the dynamics, as tables tell it."""
        return self.dynamics if isinstance(self.dynamics, str) else self.name

    def spec(self) -> VehicleSpec:
        """The vehicle under the limits.

        Raises:
            ValueError: Vehicle or limits are not valid.
        """
        spec = VehicleSpec.from_config(self.vehicle)
        own, given = spec.limits, self.limits
        tighter = replace(
            own,
            speed_max_mps=min(own.speed_max_mps, given["speed_max_mps"]),
            acceleration_min_mps2=max(own.acceleration_min_mps2, given["acceleration_min_mps2"]),
            acceleration_max_mps2=min(own.acceleration_max_mps2, given["acceleration_max_mps2"]),
        )
        return altered(replace(spec, limits=tighter), self.mass_factor, self.friction)

    def model(self, step_s: float) -> DynamicsModel:
        """The model with this step, in s.

        Raises:
            ValueError: The dynamics is unknown, or vehicle, limits or step are not valid.
        """
        return model_of(self.spec(), self.dynamics, step_s)

    def governed_speed_mps(self) -> float | None:
        """Top speed in m/s to which the drive is governed; None where the model keeps it itself."""
        kept = self.model(FINEST_NEEDED_S).keeps_top_speed
        return None if kept else self.spec().limits.speed_max_mps


def vehicle_robot(
    vehicle: SimulatedVehicle,
    step_s: float = 0.01,
    delay_s: float = 0.0,
    noise: Sequence[float] = (),
    bias: Sequence[float] = (),
    seed: int = 0,
    footprint: Footprint | None = None,
) -> VehicleRobot:
    """The robot of a benchmark, governed to its top speed.

    Args:
        vehicle: The true vehicle.
        step_s: Fine step of its motion.
        delay_s: Time until a command acts.
        noise: Standard deviation of the error of each control.
        bias: Error of each control that stays.
        seed: Of the noise.
        footprint: Its outline; the box of the vehicle if None.

    Returns:
        The robot.

    Raises:
        ValueError: The step, the delay, the noise or the bias does not fit.
    """
    for name, errors in (("noise", noise), ("bias", bias)):
        listed = isinstance(errors, Sequence) and not isinstance(errors, str)
        require(listed, name, "be a list, with a number for each control", repr(errors))
    model = vehicle.model(step_s)
    top = vehicle.governed_speed_mps()
    return VehicleRobot(
        model,
        Actuation(delay_s, tuple(noise), seed, top, tuple(bias)),
        footprint=footprint or vehicle_footprint(vehicle),
    )


def vehicle_footprint(vehicle: SimulatedVehicle) -> RectangleFootprint:
    """The box of a vehicle, around the reference point of its model."""
    return vehicle_box(vehicle.spec(), vehicle.model(FINEST_NEEDED_S))


def vehicle_box(spec: VehicleSpec, model: DynamicsModel) -> RectangleFootprint:
    """The box of a vehicle where it is, seen from the reference point of a model."""
    size = spec.footprint
    ahead = spec.centre_m - model.reference_ahead_m
    return RectangleFootprint(size.length_m, size.width_m, ahead)


def controller_model(
    believed: SimulatedVehicle,
    actual: SimulatedVehicle,
    dt_s: float = 0.25,
    step_s: float | None = None,
) -> ZeroOrderHold:
    """What a controller believes of the robot, seen from the robot's centre.

    Args:
        believed: Vehicle and dynamics that the controller believes in.
        actual: The vehicle that drives, for its reference point.
        dt_s: Time for which a control is held.
        step_s: Step of the model, which divides it. Where it is None, the longest one that the
            scheme of the model allows: 0.05 s for a kinematic bicycle with its Euler steps, one
            step per control for DiffGM3, whose error after 1 s is then at most about 1 cm.

    Returns:
        The model, in float32.

    Raises:
        ValueError: The steps do not fit.
    """
    model = believed.model(dt_s)
    if step_s is None:
        step_s = dt_s / max(1, math.ceil(dt_s / model.longest_step_s - 1e-9))
    repeats = require_multiple("dt_s", dt_s, step_s, "for the model's step `step_s`")
    robot = actual.model(FINEST_NEEDED_S)
    ahead = robot.reference_ahead_m - model.reference_ahead_m
    # a model with other controls may be believed in, but its drive is not known
    governed = "acceleration" in model.Control._fields
    top = believed.governed_speed_mps() if governed else None
    return ZeroOrderHold(believed.model(step_s), repeats, ahead, top).to(torch.float32)


def actuation(believed: SimulatedVehicle, actual: SimulatedVehicle) -> Actuate:
    """Turn controls of the believed model into those of the robot: the same driver input.

    Args:
        believed: What the controller believes in.
        actual: What drives.

    Returns:
        The map of controls.

    Raises:
        ValueError: There is no such map, because a control means something else in every state.
    """
    source, target = (each.model(FINEST_NEEDED_S) for each in (believed, actual))
    if type(source) is type(target):
        return _unchanged
    if source.driver_input_needs_state or target.driver_input_needs_state:
        pair = f"{believed.dynamics_name} for {actual.dynamics_name}"
        wanted = "share its controls with the robot's, or both be steered by an angle"
        raise ValueError(message("believed.dynamics", wanted, pair))

    def actuate(control: Float[Tensor, "*b m"]) -> Float[Tensor, "*b m"]:
        states = [
            control.new_zeros(*control.shape[:-1], each.state_dim) for each in (source, target)
        ]
        driver = source.driver_input(states[0], control)
        return target.control_for_driver(states[1], driver)

    return actuate


def _unchanged(control: Float[Tensor, "*b m"]) -> Float[Tensor, "*b m"]:
    """Both models take the same controls."""
    return control


def require_stoppable(vehicle: SimulatedVehicle, way_m: float) -> None:
    """Refuse a vehicle that cannot stop before the goal from its top speed.

    Raises:
        ValueError: Its braking distance is longer than the way.
    """
    limits = vehicle.spec().limits
    distance = limits.speed_max_mps**2 / (-2 * limits.acceleration_min_mps2)
    require(
        distance <= way_m,
        "limits",
        f"let the vehicle stop within the way of {way_m:g} m",
        f"a braking distance of {distance:.2f} m",
        remedy="Lower `limits.speed_max_mps`, or take a larger scenario.",
    )
