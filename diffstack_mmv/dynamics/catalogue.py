"""Dynamics models by their names, and vehicles that differ from what is known of them."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.utils import JobRuntime
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from diffstack_mmv.checks import require_one_of, require_positive
from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.vehicles import ParameterSpec, VehicleSpec, config_folder, load_vehicle

INERTIAS = ("yaw_inertia", "roll_inertia")


@runtime_checkable
class ModelFactory(Protocol):
    """Builds the model of a vehicle, with all settings but vehicle and step made already."""

    def __call__(self, *, spec: VehicleSpec, dt_s: float) -> DynamicsModel:
        """Model of a vehicle with steps of `dt_s`."""
        ...


def dynamics_names() -> list[str]:
    """Names of the dynamics in `configs/dynamics`, sorted."""
    return sorted(path.stem for path in (config_folder() / "dynamics").glob("*.yaml"))


def load_dynamics(name: str) -> ModelFactory:
    """Compose the dynamics of `configs/dynamics/NAME.yaml`, whatever other files it builds on.

    Args:
        name: Name of the file.

    Returns:
        What builds the model of a vehicle; vehicle and step of the file are left out.

    Raises:
        ValueError: There is no such file.
    """
    require_one_of("dynamics", name, dynamics_names())
    content: Any = OmegaConf.to_container(_composed(name), resolve=False)
    settings = {key: value for key, value in content.items() if key not in ("spec", "dt_s")}
    return instantiate(settings, _partial_=True)


def _composed(name: str) -> DictConfig:
    """The node of one dynamics; Hydra, which composes one thing at a time, may run a command."""
    running, job = GlobalHydra.instance().hydra, JobRuntime.instance().get("name")
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(config_folder()), job_name=job, version_base="1.3"):
            return compose(overrides=[f"+dynamics={name}"]).dynamics
    finally:
        GlobalHydra.instance().hydra = running


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
    build = load_dynamics(dynamics) if isinstance(dynamics, str) else dynamics
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
