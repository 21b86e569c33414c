"""Dynamics models by their short names, and vehicles that differ from what is known of them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from diffstack_mmv.checks import require_one_of, require_positive
from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.gm3.model import DiffGM3
from diffstack_mmv.dynamics.kbm import DiffKBM
from diffstack_mmv.dynamics.unicycle import ExtendedUnicycle
from diffstack_mmv.vehicles import ParameterSpec, VehicleSpec, load_vehicle

MODELS: dict[str, Callable[..., DynamicsModel]] = {
    "unicycle": ExtendedUnicycle,
    "kbm": DiffKBM,
    "gm3": DiffGM3,
}
INERTIAS = ("yaw_inertia", "roll_inertia")


def model_of(vehicle: str | Path | VehicleSpec, dynamics: str, dt_s: float) -> DynamicsModel:
    """Build the model of a vehicle.

    Args:
        vehicle: A vehicle, its name, or the path of its YAML file.
        dynamics: Short name of the model.
        dt_s: Length of one step in s.

    Returns:
        The model.

    Raises:
        ValueError: The vehicle or the dynamics is unknown, or the step is not positive.
    """
    require_one_of("dynamics", dynamics, tuple(MODELS))
    spec = vehicle if isinstance(vehicle, VehicleSpec) else load_vehicle(vehicle)
    return MODELS[dynamics](spec, dt_s=dt_s)


def altered(
    spec: VehicleSpec, mass_factor: float = 1.0, friction: float | None = None
) -> VehicleSpec:
    """The same vehicle with another load or on another road, for tests of robustness.

    Args:
        spec: The vehicle.
        mass_factor: Scales the mass and, as for a load spread like the mass, the inertias.
        friction: Friction coefficient μ of all tyres; unchanged if None.

    Returns:
        The altered vehicle; the ranges of altered parameters move with them.

    Raises:
        ValueError: The factor or the friction is not positive.
    """
    require_positive("mass_factor", mass_factor)
    parameters = dict(spec.parameters)
    for name in INERTIAS:
        parameters[name] = _scaled(parameters[name], mass_factor)
    if friction is not None:
        require_positive("friction", friction)
        source = "altered for a test of robustness"
        parameters["friction"] = replace(
            parameters["friction"], initial=friction, low=friction, high=friction, source=source
        )
    return replace(spec, mass_kg=spec.mass_kg * mass_factor, parameters=parameters)


def _scaled(parameter: ParameterSpec, factor: float) -> ParameterSpec:
    """A parameter of one number with value and range scaled."""
    (initial, low, high) = parameter.entries()[0]
    return replace(parameter, initial=initial * factor, low=low * factor, high=high * factor)
