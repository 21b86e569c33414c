"""Vehicles of a benchmark: the one that drives, and the one its controller believes in."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require, require_multiple
from diffstack_mmv.dynamics import DiffKBM, DynamicsModel
from diffstack_mmv.dynamics.catalogue import MODELS, VehicleSpec, altered, model_of
from diffstack_mmv.dynamics.gm3.model import DiffGM3
from diffstack_mmv.dynamics.gm3.steering import turning_axle_m
from diffstack_mmv.simulation.held import HeldControl
from diffstack_mmv.simulation.vehicle_robot import Actuation, VehicleRobot

EULER_STEP_S = 0.05
"""Step of a kinematic bicycle within a plan."""
Actuate = Callable[[Float[Tensor, "*b m"]], Float[Tensor, "*b m"]]


@dataclass(frozen=True)
class Driven:
    """A vehicle under limits, on a road, in the eyes of one dynamics model.

    Attributes:
        vehicle: The vehicle as its YAML file describes it.
        dynamics: Short name of the model; of a variant such as "gm3_paper" the first part counts.
        limits: Largest speed and accelerations; the tighter of these and the vehicle's own hold.
        mass_factor: Scales the mass.
        friction: Friction coefficient of all tyres; the vehicle's own if None.

    Raises:
        ValueError: The dynamics is unknown, or vehicle or limits are not valid.
    """

    vehicle: Mapping[str, Any]
    dynamics: str
    limits: Mapping[str, float]
    mass_factor: float = 1.0
    friction: float | None = None

    def spec(self) -> VehicleSpec:
        """The vehicle under the limits."""
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
        """The model with this step."""
        return model_of(self.spec(), self.dynamics.split("_")[0], step_s)

    def reference_m(self) -> float:
        """Longitudinal position of the model's reference point ahead of the centre of gravity."""
        is_gm3 = MODELS.get(self.dynamics.split("_")[0]) is DiffGM3
        return 0.0 if is_gm3 else turning_axle_m(self.spec().wheels)


def vehicle_robot(
    driven: Driven,
    step_s: float = 0.01,
    delay_s: float = 0.0,
    noise: Sequence[float] = (),
    seed: int = 0,
) -> VehicleRobot:
    """The robot of a benchmark, governed to its top speed.

    Args:
        driven: The true vehicle.
        step_s: Fine step of its motion.
        delay_s: Time until a command acts.
        noise: Standard deviation of the error of each control.
        seed: Of the noise.

    Returns:
        The robot.

    Raises:
        ValueError: The step, the delay or the noise does not fit.
    """
    speed = driven.spec().limits.speed_max_mps
    return VehicleRobot(
        driven.model(step_s), Actuation(delay_s, tuple(noise), seed, speed_max_mps=speed)
    )


def controller_model(
    believed: Driven, actual: Driven, dt_s: float = 0.25, step_s: float | None = None
) -> HeldControl:
    """What a controller believes of the robot, seen from the robot's centre.

    Args:
        believed: Vehicle and dynamics that the controller believes in.
        actual: The vehicle that drives, for its reference point.
        dt_s: Time for which a control is held.
        step_s: Step of the model, which divides it. Where it is None, a kinematic bicycle with its
            Euler steps takes 0.05 s, any other model one step per control: the error of DiffGM3
            after 1 s in steps of 0.25 s is at most about 1 cm.

    Returns:
        The model, in float32.

    Raises:
        ValueError: The steps do not fit.
    """
    if step_s is None:
        step_s = EULER_STEP_S if isinstance(believed.model(dt_s), DiffKBM) else dt_s
    repeats = require_multiple("dt_s", dt_s, step_s, "for the model's step `step_s`")
    ahead = actual.reference_m() - believed.reference_m()
    return HeldControl(believed.model(step_s), repeats, ahead).to(torch.float32)


def actuation(believed: Driven, actual: Driven) -> Actuate:
    """Turn controls of the believed model into those of the robot: the same angle at the handlebar.

    The command of DiffGM3 is clamped softly inside of the model, that of DiffKBM is the angle.

    Args:
        believed: What the controller believes in.
        actual: What drives.

    Returns:
        The map of controls.

    Raises:
        ValueError: There is no such map.
    """
    source, target = believed.model(0.01), actual.model(0.01)
    if type(source) is type(target):
        return _unchanged
    if isinstance(source, DiffKBM) and isinstance(target, DiffGM3):
        return _on_steer(target.chassis.steering.command_for)
    if isinstance(source, DiffGM3) and isinstance(target, DiffKBM):
        return _on_steer(source.chassis.steering.clamped)
    pair = f"{believed.dynamics} for {actual.dynamics}"
    raise ValueError(message("model_dynamics", "share its controls with the robot's", pair))


def _unchanged(control: Float[Tensor, "*b m"]) -> Float[Tensor, "*b m"]:
    """Both models take the same controls."""
    return control


def _on_steer(change: Callable[[Tensor], Tensor]) -> Actuate:
    """Change the steering, the second of the two controls."""

    def actuate(control: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b 2"]:
        return torch.stack([control[..., 0], change(control[..., 1])], -1)

    return actuate


def require_stoppable(driven: Driven, way_m: float) -> None:
    """Refuse a vehicle that cannot stop before the goal from its top speed.

    Raises:
        ValueError: Its braking distance is longer than the way.
    """
    limits = driven.spec().limits
    distance = limits.speed_max_mps**2 / (-2 * limits.acceleration_min_mps2)
    require(
        distance <= way_m,
        "limits",
        f"let the vehicle stop within the way of {way_m:g} m",
        f"a braking distance of {distance:.2f} m",
        remedy="Lower `limits.speed_max_mps`, or take a larger scenario.",
    )
