"""From the content of a vehicle's YAML file to the fields of a `VehicleSpec`, and back."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from diffstack_mmv.vehicles.parts import (
    BODY_PARAMETERS,
    WHEEL_PARAMETERS,
    AckermannSteering,
    DifferentialDrive,
    FootprintSpec,
    Limits,
    Smoothing,
    Steering,
    TruckSteering,
    WheelSpec,
)
from diffstack_mmv.vehicles.quantity import ParameterSpec, as_numbers
from diffstack_mmv.vehicles.values import (
    built_at,
    flag_at,
    number_at,
    record_at,
    require_keys,
    require_mapping,
    whole_number_at,
)
from dmmv_conventions.checks import message, require

_REQUIRED = (
    "name",
    "mode",
    "mass_kg",
    "height_m",
    "wheelbase",
    "limits",
    "footprint",
    "wheels",
    "parameters",
)
_OPTIONAL = ("steering", "leans", "balanced", "reverse", "smoothing", "sources", "provenance")
_NEUTRAL = {
    "length_scale": ParameterSpec(1.0, 1.0, 1.0, "1", False, "wheel positions as given"),
    "rolling_resistance": ParameterSpec(0.0, 0.0, 0.0, "1", False, "neglected"),
    "drag": ParameterSpec(0.0, 0.0, 0.0, "N s^2/m^2", False, "neglected"),
}
_STEERING = {
    "ackermann": AckermannSteering,
    "trucks": TruckSteering,
    "differential": DifferentialDrive,
}


def _parameter(mapping: Any, path: str, where: str) -> ParameterSpec:
    required = ("initial", "low", "high", "unit", "learn", "source")
    require_keys(mapping, required, ("tied",), path, where)
    numbers = {}
    for key in ("initial", "low", "high"):
        value = mapping[key]
        entries = value if isinstance(value, list | tuple) else [value]
        checked = [number_at(entry, f"{path}{key}", where) for entry in entries]
        numbers[key] = as_numbers(checked if isinstance(value, list | tuple) else checked[0])
    texts = {
        key: str(mapping[key]) if mapping[key] is not None else "" for key in ("unit", "source")
    }
    flags = {
        key: flag_at(mapping[key], f"{path}{key}", where)
        for key in ("learn", "tied")
        if key in mapping
    }
    return built_at(ParameterSpec, {**numbers, **texts, **flags}, path, where)


def _wheel(name: str, mapping: Any, path: str, where: str) -> WheelSpec:
    known = [field.name for field in fields(WheelSpec) if field.name != "name"]
    require_keys(mapping, ("x_m", "y_m", "radius_m"), known[3:], path, where)
    readers = {"truck": whole_number_at} | dict.fromkeys(
        ("steered", "driven", "braked", "caster"), flag_at
    )
    arguments: dict[str, Any] = {"name": name}
    for key, value in mapping.items():
        read = readers.get(key, number_at)
        arguments[key] = read(value, f"{path}{key}", where)
    return built_at(WheelSpec, arguments, path, where)


def _steering(mapping: Any, where: str) -> Steering:
    require_keys(mapping, (), tuple(_STEERING), "steering.", where)
    require(
        len(mapping) == 1,
        "steering",
        f"have exactly one of {', '.join(_STEERING)}",
        list(mapping),
        where,
    )
    (kind, settings), *_ = mapping.items()
    return record_at(_STEERING[kind], settings or {}, f"steering.{kind}.", where)


def fields_from_config(mapping: Mapping[str, Any]) -> dict[str, Any]:
    """Read the fields of a `VehicleSpec` from the content of its YAML file.

    Raises:
        ValueError: A key is unknown or missing, or a value is impossible.
    """
    where = f"for vehicle '{mapping.get('name', '?')}'" if isinstance(mapping, Mapping) else ""
    require_keys(mapping, _REQUIRED, _OPTIONAL, "", where)
    for key in ("name", "mode"):
        told = mapping[key]
        require(isinstance(told, str | int) and told != "", key, "be text", repr(told), where)
    for group in ("wheels", "parameters"):
        require(
            isinstance(mapping[group], Mapping),
            group,
            "be a mapping from names",
            repr(mapping[group]),
            where,
        )
    notes = {key: mapping.get(key) or {} for key in ("sources", "provenance")}
    for key, value in notes.items():
        require_mapping(value, key, where)
    known = [*WHEEL_PARAMETERS, *BODY_PARAMETERS]
    required = [name for name in known if name not in _NEUTRAL]
    require_keys(mapping["parameters"], required, tuple(_NEUTRAL), "parameters.", where)
    wheels = mapping["wheels"].items()
    parameters = mapping["parameters"].items()
    return {
        "name": str(mapping["name"]),
        "mode": str(mapping["mode"]),
        "mass_kg": number_at(mapping["mass_kg"], "mass_kg", where),
        "height_m": number_at(mapping["height_m"], "height_m", where),
        "wheelbase": _parameter(mapping["wheelbase"], "wheelbase.", where),
        "limits": record_at(Limits, mapping["limits"], "limits.", where),
        "footprint": record_at(FootprintSpec, mapping["footprint"], "footprint.", where),
        "wheels": tuple(
            _wheel(str(name), entry, f"wheels.{name}.", where) for name, entry in wheels
        ),
        "steering": _steering(mapping.get("steering", {"ackermann": {}}), where),
        "parameters": _NEUTRAL
        | {name: _parameter(entry, f"parameters.{name}.", where) for name, entry in parameters},
        "smoothing": record_at(Smoothing, mapping.get("smoothing", {}), "smoothing.", where),
        **{
            key: flag_at(mapping.get(key, False), key, where)
            for key in ("leans", "balanced", "reverse")
        },
        **{key: dict(value) for key, value in notes.items()},
    }


def _plain(record: Any) -> dict[str, Any]:
    """Fields of a dataclass that differ from their defaults, tuples as lists."""
    values = {
        field.name: getattr(record, field.name) for field in fields(record) if field.name != "name"
    }
    defaults = {field.name: field.default for field in fields(record)}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in values.items()
        if value != defaults[key]
    }


def config_from_spec(spec: Any) -> dict[str, Any]:
    """Content of the YAML file of a `VehicleSpec`: the inverse of `fields_from_config`.

    Raises:
        ValueError: The steering is of an unknown kind.
    """
    kinds = [name for name, kind in _STEERING.items() if isinstance(spec.steering, kind)]
    if not kinds:
        raise ValueError(
            message("steering", f"be one of {', '.join(_STEERING)}", type(spec.steering).__name__)
        )
    return {
        "name": spec.name,
        "mode": spec.mode,
        "mass_kg": spec.mass_kg,
        "height_m": spec.height_m,
        **{flag: True for flag in ("leans", "balanced", "reverse") if getattr(spec, flag)},
        "steering": {kinds[0]: _plain(spec.steering)},
        "wheelbase": _plain(spec.wheelbase),
        "limits": _plain(spec.limits),
        "footprint": _plain(spec.footprint),
        "wheels": {wheel.name: _plain(wheel) for wheel in spec.wheels},
        "parameters": {name: _plain(parameter) for name, parameter in spec.parameters.items()},
        "smoothing": _plain(spec.smoothing),
        "sources": dict(spec.sources),
        **({"provenance": dict(spec.provenance)} if spec.provenance else {}),
    }
