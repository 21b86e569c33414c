"""What a vehicle is: wheels, masses, limits, footprint and parameters, checked when built."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from diffstack_mmv.vehicles.layout import require_possible_layout, steered_length_m
from diffstack_mmv.vehicles.parts import (
    BODY_PARAMETERS,
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
from dmmv_conventions.checks import message, require, require_at_least, require_positive
from dmmv_conventions.modes import Mode

_POSITIVE = (
    "friction",
    "tread_stiffness",
    "contact_half_length",
    "yaw_inertia",
    "roll_inertia",
    "length_scale",
)

WHEELBASE_APART = 1.5  # times what the wheels say, or a part of it; calibrated ones differ by less
FOOTPRINTS_MAX = 10.0  # a length beyond is in another unit than metres


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
        if self.leans:
            require_positive(
                "limits.lean_max_rad",
                self.limits.lean_max_rad,
                where,
                "A leaning vehicle needs it.",
            )
        require_possible_layout(self.wheels, self.steering, self.leans or self.balanced, where)
        self._require_metres(where)
        self._require_parameters(where)
        unit = repr(self.wheelbase.unit)
        remedy = "Convert initial, low and high."
        require(self.wheelbase.unit == "m", "wheelbase.unit", "be 'm'", unit, where, remedy)
        for _, low, _ in self.wheelbase.entries():
            require_positive(
                "wheelbase.low", low, where, "A vehicle with one axle takes a virtual wheelbase."
            )
        self._require_consistent(where)

    def _require_consistent(self, where: str) -> None:
        """Refuse a wheelbase far from that of the wheels, and a roll inertia below m h²."""
        length, (_, low, high) = steered_length_m(self.wheels), self.wheelbase.entries()[0]
        require(
            length == 0 or low / WHEELBASE_APART <= length <= high * WHEELBASE_APART,
            "wheelbase",
            f"fit the wheels, which steer as a bicycle of {length:g} m",
            f"low = {low:g} and high = {high:g}",
            where,
            "Measure from the steered axle to the one that does not steer.",
        )
        if self.leans:
            inertia, swing = self.parameters["roll_inertia"], self.mass_kg * self.height_m**2
            require(
                inertia.entries()[0][0] >= swing * (1 - 1e-6),
                "parameters.roll_inertia.initial",
                f"be at least m h² = {swing:g} of a leaning vehicle",
                inertia.initial,
                where,
                "It is that about the line on the ground.",
            )

    def _require_metres(self, where: str) -> None:
        """Refuse lengths in centimetres or millimetres: out of all proportion to the footprint."""
        longest = max(self.footprint.length_m, self.footprint.width_m)
        lengths = {"height_m": self.height_m, "wheelbase.initial": self.wheelbase.entries()[0][0]}
        for wheel in self.wheels:
            for key in ("x_m", "y_m", "radius_m"):
                lengths[f"wheels.{wheel.name}.{key}"] = abs(getattr(wheel, key))
        for key, length in lengths.items():
            require(
                length <= FOOTPRINTS_MAX * longest,
                key,
                f"be at most {FOOTPRINTS_MAX:g} times the footprint of {longest:g} m",
                f"{length:g}",
                where,
                "Give metres.",
            )

    def _require_parameters(self, where: str) -> None:
        known = WHEEL_PARAMETERS | BODY_PARAMETERS
        for name, unit in known.items():
            require(name in self.parameters, f"parameters.{name}", "be given", "nothing", where)
            parameter = self.parameters[name]
            require(
                parameter.unit == unit,
                f"parameters.{name}.unit",
                f"be '{unit}'",
                repr(parameter.unit),
                where,
                "Convert initial, low and high.",
            )
            lengths = (None, len(self.wheels)) if name in WHEEL_PARAMETERS else (None,)
            remedy = (
                f"The vehicle has {len(self.wheels)} wheels." if name in WHEEL_PARAMETERS else ""
            )
            require(
                parameter.length in lengths,
                f"parameters.{name}",
                "be one number, or one per wheel" if name in WHEEL_PARAMETERS else "be one number",
                f"{parameter.length} entries",
                where,
                remedy,
            )
            for _, low, _ in parameter.entries():
                if name in _POSITIVE:
                    require_positive(f"parameters.{name}.low", low, where)
                else:
                    require_at_least(f"parameters.{name}.low", low, 0.0, where)
        for name in self.parameters:
            require(
                name in known,
                f"parameters.{name}",
                f"be one of {', '.join(known)}",
                "an unknown name",
                where,
            )

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
        parameters = dict(self.parameters)
        wheelbase = self.wheelbase
        for name, value in values.items():
            if name == "wheelbase":
                wheelbase = wheelbase.with_value(_single(value), source)
                continue
            require(
                name in parameters, name, f"be one of {', '.join(parameters)}", "an unknown name"
            )
            spec = self.wheel_parameter(name) if name in WHEEL_PARAMETERS else parameters[name]
            parameters[name] = spec.with_value(value if spec.length else _single(value), source)
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


def _single(value: float | Sequence[float]) -> float:
    return float(value[0]) if isinstance(value, Sequence) else float(value)
