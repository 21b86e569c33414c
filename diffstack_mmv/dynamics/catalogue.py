"""Dynamics models by their names, and vehicles that differ from what is known of them."""

from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.vehicles import ParameterSpec, VehicleSpec, load_vehicle
from dmmv_conventions.config_files import factory, names_in, settings_of
from dmmv_conventions.configs import config_folder

INERTIAS = ("yaw_inertia", "roll_inertia")


@runtime_checkable
class ModelFactory(Protocol):
    """Builds the model of a vehicle, with all settings but vehicle and step made already."""

    def __call__(self, *, spec: VehicleSpec, dt_s: float) -> DynamicsModel:
        """Model of a vehicle with steps of `dt_s`."""
        ...


def dynamics_names() -> list[str]:
    """Names of the dynamics in `configs/dynamics`, sorted."""
    return names_in(config_folder() / "dynamics")


def load_dynamics(name: str) -> ModelFactory:
    """Compose the dynamics of `configs/dynamics/NAME.yaml`, whatever other files it builds on.

    Args:
        name: Name of the file.

    Returns:
        What builds the model of a vehicle; vehicle and step of the file are left out.

    Raises:
        ValueError: There is no such file, or a setting in it is left to the command line.
    """
    settings = settings_of(name, config_folder() / "dynamics")
    return factory({key: each for key, each in settings.items() if key not in ("spec", "dt_s")})


def model_of(
    vehicle: str | Path | VehicleSpec, dynamics: str | ModelFactory, dt_s: float
) -> DynamicsModel:
    """Build the model of a vehicle.

    Args:
        vehicle: A vehicle, its name, or the path of its YAML file.
        dynamics: What builds the model, or the name of a file of `configs/dynamics`.
        dt_s: Length of one step in s.

    Returns:
        The model.

    Raises:
        ValueError: The vehicle or the dynamics is unknown, or the step is not positive.
    """
    build = dynamics if isinstance(dynamics, ModelFactory) else load_dynamics(dynamics)
    spec = vehicle if isinstance(vehicle, VehicleSpec) else load_vehicle(vehicle)
    return build(spec=spec, dt_s=dt_s)


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
