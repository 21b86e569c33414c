"""From the content of a vehicle's YAML file to the fields of a `VehicleSpec`, and back."""

import difflib
from collections.abc import Callable, Collection, Mapping
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


def _require_keys(
    mapping: Any, required: Collection[str], optional: Collection[str], path: str, where: str
) -> None:
    require(
        isinstance(mapping, Mapping),
        path or "vehicle",
        "be a mapping of keys",
        repr(mapping),
        where,
    )
    known = [*required, *optional]
    for key in mapping:
        close = difflib.get_close_matches(str(key), known, 1, 0.5)
        hint = f"Did you mean `{close[0]}`?" if close else "Remove it."
        require(
            key in known,
            f"{path}{key}",
            f"be one of {', '.join(known)}",
            "an unknown key",
            where,
            hint,
        )
    for key in required:
        require(key in mapping, f"{path}{key}", "be given", "nothing", where, f"Add `{key}`.")


def _number(value: Any, path: str, where: str) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool)
    require(
        good,
        path,
        "be a number",
        repr(value),
        where,
        "Write the plain number; the unit stands in the key.",
    )
    return float(value)


def _whole_number(value: Any, path: str, where: str) -> int:
    number = _number(value, path, where)
    require(number.is_integer(), path, "be a whole number", repr(value), where)
    return int(number)


def _flag(value: Any, path: str, where: str) -> bool:
    require(isinstance(value, bool), path, "be true or false", repr(value), where)
    return value


def _built(build: Callable[..., Any], arguments: Mapping[str, Any], path: str, where: str) -> Any:
    try:
        return build(**arguments)
    except ValueError as problem:
        place = path.rstrip(".")
        raise ValueError(f"{problem} (`{place}` {where})") from problem


def _record(kind: type, mapping: Any, path: str, where: str) -> Any:
    """Build a dataclass of numbers and flags from a mapping with the same keys."""
    known = {field.name: field for field in fields(kind)}
    given = [key for key, field in known.items() if field.default is field.default_factory]
    optional = [key for key in known if key not in given]
    _require_keys(mapping, given, optional, path, where)
    arguments = {}
    for key, value in mapping.items():
        read = _flag if known[key].type is bool else _number
        arguments[key] = read(value, f"{path}{key}", where)
    return _built(kind, arguments, path, where)


def _parameter(mapping: Any, path: str, where: str) -> ParameterSpec:
    required = ("initial", "low", "high", "unit", "learn", "source")
    _require_keys(mapping, required, ("tied",), path, where)
    numbers = {}
    for key in ("initial", "low", "high"):
        value = mapping[key]
        entries = value if isinstance(value, list | tuple) else [value]
        checked = [_number(entry, f"{path}{key}", where) for entry in entries]
        numbers[key] = as_numbers(checked if isinstance(value, list | tuple) else checked[0])
    texts = {
        key: str(mapping[key]) if mapping[key] is not None else "" for key in ("unit", "source")
    }
    flags = {
        key: _flag(mapping[key], f"{path}{key}", where)
        for key in ("learn", "tied")
        if key in mapping
    }
    return _built(ParameterSpec, {**numbers, **texts, **flags}, path, where)


def _wheel(name: str, mapping: Any, path: str, where: str) -> WheelSpec:
    known = [field.name for field in fields(WheelSpec) if field.name != "name"]
    _require_keys(mapping, ("x_m", "y_m", "radius_m"), known[3:], path, where)
    readers = {"truck": _whole_number} | dict.fromkeys(
        ("steered", "driven", "braked", "caster"), _flag
    )
    arguments: dict[str, Any] = {"name": name}
    for key, value in mapping.items():
        read = readers.get(key, _number)
        arguments[key] = read(value, f"{path}{key}", where)
    return _built(WheelSpec, arguments, path, where)


def _steering(mapping: Any, where: str) -> Steering:
    _require_keys(mapping, (), tuple(_STEERING), "steering.", where)
    require(
        len(mapping) == 1,
        "steering",
        f"have exactly one of {', '.join(_STEERING)}",
        list(mapping),
        where,
    )
    (kind, settings), *_ = mapping.items()
    return _record(_STEERING[kind], settings or {}, f"steering.{kind}.", where)


def fields_from_config(mapping: Mapping[str, Any]) -> dict[str, Any]:
    """Read the fields of a `VehicleSpec` from the content of its YAML file.

    Raises:
        ValueError: A key is unknown or missing, or a value is impossible.
    """
    where = f"for vehicle '{mapping.get('name', '?')}'" if isinstance(mapping, Mapping) else ""
    _require_keys(mapping, _REQUIRED, _OPTIONAL, "", where)
    for key in ("name", "mode"):
        require(isinstance(mapping[key], str | int), key, "be text", repr(mapping[key]), where)
    for group in ("wheels", "parameters"):
        require(
            isinstance(mapping[group], Mapping),
            group,
            "be a mapping from names",
            repr(mapping[group]),
            where,
        )
    known = [*WHEEL_PARAMETERS, *BODY_PARAMETERS]
    required = [name for name in known if name not in _NEUTRAL]
    _require_keys(mapping["parameters"], required, tuple(_NEUTRAL), "parameters.", where)
    wheels = mapping["wheels"].items()
    parameters = mapping["parameters"].items()
    return {
        "name": str(mapping["name"]),
        "mode": str(mapping["mode"]),
        "mass_kg": _number(mapping["mass_kg"], "mass_kg", where),
        "height_m": _number(mapping["height_m"], "height_m", where),
        "wheelbase": _parameter(mapping["wheelbase"], "wheelbase.", where),
        "limits": _record(Limits, mapping["limits"], "limits.", where),
        "footprint": _record(FootprintSpec, mapping["footprint"], "footprint.", where),
        "wheels": tuple(
            _wheel(str(name), entry, f"wheels.{name}.", where) for name, entry in wheels
        ),
        "steering": _steering(mapping.get("steering", {"ackermann": {}}), where),
        "parameters": _NEUTRAL
        | {name: _parameter(entry, f"parameters.{name}.", where) for name, entry in parameters},
        "smoothing": _record(Smoothing, mapping.get("smoothing", {}), "smoothing.", where),
        **{
            key: _flag(mapping.get(key, False), key, where)
            for key in ("leans", "balanced", "reverse")
        },
        **{key: dict(mapping.get(key) or {}) for key in ("sources", "provenance")},
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
