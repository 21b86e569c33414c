"""What a vehicle is: wheels, masses, limits, footprint and parameters, checked when built."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from diffstack_mmv.vehicles.consistency import (
    require_footprint_of_wheels,
    require_metres,
    require_parameters,
    require_roll_inertia,
    require_wheelbase,
    require_wheelbase_of_wheels,
    require_yaw_inertia,
)
from diffstack_mmv.vehicles.layout import require_possible_layout
from diffstack_mmv.vehicles.parts import (
    WHEEL_PARAMETERS,
    FootprintSpec,
    Limits,
    Smoothing,
    Steering,
    WheelSpec,
)
from diffstack_mmv.vehicles.quantity import ParameterSpec
from diffstack_mmv.vehicles.reading import fields_from_config
from diffstack_mmv.vehicles.reference import fields_from_reference
from diffstack_mmv.vehicles.values import built_at
from dmmv_conventions.checks import message, require, require_positive, require_switch
from dmmv_conventions.modes import Mode


def require_vehicle(spec: object) -> None:
    """Refuse anything but a `VehicleSpec`.

    Raises:
        TypeError: `spec` is something else, a name for example.
    """
    if not isinstance(spec, VehicleSpec):
        found = f"{type(spec).__name__} {spec!r}"
        remedy = "Give load_vehicle(NAME_OR_PATH)."
        raise TypeError(message("spec", "be a VehicleSpec", found, "", remedy))


@dataclass(frozen=True)
class VehicleSpec:
    """A vehicle with its rider. Positions are relative to the centre of gravity: x forward, y left.

    Args:
        name: Name of the vehicle.
        mode: Mode of transport it belongs to, the name of a `types.Mode`.
        mass_kg: Mass with rider.
        height_m: Height of the centre of gravity.
        wheelbase: Wheelbase of the kinematic bicycle in m; a virtual one for a single axle.
        limits: What it can do at most.
        footprint: Outline seen from above, its middle at `centre_m`.
        wheels: All wheels.
        steering: How a steering command turns the wheels.
        parameters: Physical parameters by name, see `WHEEL_PARAMETERS` and `BODY_PARAMETERS`.
        leans: Whether it leans into turns; the lean is then part of the state's dynamics.
        balanced: Whether the rider balances it, so that no load moves sideways.
        reverse: Whether a negative acceleration drives it backwards instead of braking to a halt.
        smoothing: Widths of the smooth transitions at standstill and at the friction limit.
        sources: Where the plain numbers come from, nested like the configuration.
        provenance: How the parameters were calibrated, empty for a prior.

    Raises:
        ValueError: A number is impossible, a parameter is missing or unknown, or the wheel layout
            cannot stand.
    """

    name: str
    mode: str
    mass_kg: float
    height_m: float
    wheelbase: ParameterSpec
    limits: Limits
    footprint: FootprintSpec
    wheels: tuple[WheelSpec, ...]
    steering: Steering
    parameters: Mapping[str, ParameterSpec]
    leans: bool = False
    balanced: bool = False
    reverse: bool = False
    smoothing: Smoothing = field(default_factory=Smoothing)
    sources: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f"for vehicle '{self.name}'"
        Mode.named(self.mode)
        require_positive("mass_kg", self.mass_kg, where, "Give the mass with the rider.")
        require_positive("height_m", self.height_m, where)
        for flag in ("leans", "balanced", "reverse"):
            require_switch(flag, getattr(self, flag), where)
        if self.leans:
            lean, remedy = self.limits.lean_max_rad, "A leaning vehicle needs it."
            require_positive("limits.lean_max_rad", lean, where, remedy)
        require_possible_layout(self.wheels, self.steering, self.leans or self.balanced, where)
        require_metres(self.footprint, self._lengths(), where)
        require_parameters(self.parameters, len(self.wheels), where)
        require_wheelbase(self.wheelbase, where)
        require_wheelbase_of_wheels(self.wheelbase, self.wheels, where)
        require_footprint_of_wheels(self.footprint, self.wheels, where)
        yaw_inertia = self.parameters["yaw_inertia"]
        require_yaw_inertia(yaw_inertia, self.mass_kg, self.footprint, where)
        if self.leans:
            inertia = self.parameters["roll_inertia"]
            require_roll_inertia(inertia, self.mass_kg, self.height_m, where)

    def _lengths(self) -> dict[str, float]:
        """Everything in metres, by its place in the configuration."""
        lengths = {"height_m": self.height_m, "wheelbase.initial": self.wheelbase.entries()[0][0]}
        return lengths | {
            f"wheels.{wheel.name}.{key}": getattr(wheel, key)
            for wheel in self.wheels
            for key in ("x_m", "y_m", "radius_m")
        }

    @property
    def front_m(self) -> float:
        """Distance from the centre of gravity to the front axle in m (0 for a single axle)."""
        return max(wheel.x_m for wheel in self.wheels)

    @property
    def rear_m(self) -> float:
        """Distance from the centre of gravity to the rear axle in m (0 for a single axle)."""
        return 0.0 - min(wheel.x_m for wheel in self.wheels)

    @property
    def centre_m(self) -> float:
        """Middle of the footprint ahead of the centre of gravity in m: midway between the axles."""
        return 0.5 * (self.front_m - self.rear_m)

    def per_wheel(self, attribute: str) -> list[float]:
        """One number per wheel of a `WheelSpec` attribute, e.g. `x_m`."""
        return [float(getattr(wheel, attribute)) for wheel in self.wheels]

    def wheel_parameter(self, name: str) -> ParameterSpec:
        """Return a wheel parameter with one entry per wheel."""
        parameter = self.parameters[name]
        if parameter.length is not None:
            return parameter
        (initial, low, high) = parameter.entries()[0]
        count = len(self.wheels)
        return replace(
            parameter, initial=(initial,) * count, low=(low,) * count, high=(high,) * count
        )

    def with_values(
        self, values: Mapping[str, float | Sequence[float]], source: str = "calibrated"
    ) -> "VehicleSpec":
        """Return the same vehicle with other priors, e.g. the estimates of an identification.

        Args:
            values: By parameter name, or `wheelbase`; one number, or one per wheel.
            source: Where the new numbers come from.

        Raises:
            ValueError: A name is unknown or the number of values does not fit.
        """
        parameters, wheelbase = dict(self.parameters), self.wheelbase

        def moved(prior: ParameterSpec, name: str) -> ParameterSpec:
            given = {"value": values[name], "source": source}
            return built_at(prior.with_value, given, name, f"for vehicle '{self.name}'")

        for name in values:
            if name == "wheelbase":
                wheelbase = moved(wheelbase, name)
                continue
            require(
                name in parameters, name, f"be one of {', '.join(parameters)}", "an unknown name"
            )
            of_wheels = name in WHEEL_PARAMETERS
            prior = self.wheel_parameter(name) if of_wheels else parameters[name]
            parameters[name] = moved(prior, name)
        return replace(self, parameters=parameters, wheelbase=wheelbase)

    @classmethod
    def from_config(cls, mapping: Mapping[str, Any]) -> "VehicleSpec":
        """Build a vehicle from the content of a YAML file.

        Raises:
            ValueError: A key is unknown or missing, or a number is impossible; the message names
                vehicle, field, value and remedy.
        """
        return cls(**fields_from_config(mapping))

    @classmethod
    def from_reference(cls, entry: Mapping[str, Any]) -> "VehicleSpec":
        """Build a vehicle from an entry of the reference parameter sets (their keys and units).

        Raises:
            ValueError: A number is missing or impossible.
        """
        return cls(**fields_from_reference(entry))
