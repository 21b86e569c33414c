"""From a parameter set with the symbols of the GM3 papers to the fields of a `VehicleSpec`."""

from collections.abc import Mapping, Sequence
from typing import Any

from diffstack_mmv.vehicles.parts import (
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
from dmmv_conventions.checks import require, require_positive

SOURCE = "reference parameter set"
_SCALARS = (
    "m",
    "Iz",
    "Ix",
    "h",
    "lf",
    "lr",
    "delta_max",
    "gamma_max",
    "k_align",
    "d_yaw",
    "d_roll",
)
_WHEEL_COLUMNS = (
    "x",
    "y",
    "R",
    "mu",
    "cp",
    "l",
    "eps_gamma",
    "steer",
    "truck",
    "drive",
    "brake",
    "caster",
)
_OVERHANG_M = 0.6
_WIDTH_M = 0.5


def _constant(value: float, unit: str) -> ParameterSpec:
    return ParameterSpec(value, value, value, unit, False, SOURCE)


def _scaled(
    value: float | Sequence[float], low: float, high: float, unit: str, tied: bool = False
) -> ParameterSpec:
    """Parameter with a range given as multiples of its value."""
    numbers = as_numbers(value)
    if isinstance(numbers, tuple):
        lows, highs = (
            tuple(low * number for number in numbers),
            tuple(high * number for number in numbers),
        )
        return ParameterSpec(numbers, lows, highs, unit, True, SOURCE, tied)
    return ParameterSpec(numbers, low * numbers, high * numbers, unit, True, SOURCE)


def _steering(entry: Mapping[str, Any]) -> Steering:
    steerings: dict[str, Steering] = {
        "ackermann": AckermannSteering(),
        "truck": TruckSteering(entry["truck_gain"], entry["truck_beta"]),
        "diff": DifferentialDrive(entry["L_virtual"], entry["tau_yaw"], entry["eta_yaw"]),
    }
    control = entry["control"]
    require(control in steerings, "control", f"be one of {', '.join(steerings)}", repr(control))
    return steerings[control]


def _wheels(columns: Mapping[str, Sequence[float]]) -> tuple[WheelSpec, ...]:
    return tuple(
        WheelSpec(
            name=f"wheel_{index}",
            x_m=columns["x"][index],
            y_m=columns["y"][index],
            radius_m=columns["R"][index],
            steered=bool(columns["steer"][index]),
            truck=int(columns["truck"][index]),
            driven=bool(columns["drive"][index]),
            braked=bool(columns["brake"][index]),
            caster=bool(columns["caster"][index]),
            camber_reduction=columns["eps_gamma"][index],
        )
        for index in range(len(columns["x"]))
    )


def _parameters(entry: Mapping[str, Any]) -> dict[str, ParameterSpec]:
    columns = entry["wheels"]
    tied = len(columns["x"]) > 2  # left and right stay alike
    # the part of the roll inertia that the centre of gravity makes by itself
    swing = entry["m"] * entry["h"] ** 2
    friction = as_numbers(columns["mu"])
    roll_inertia = entry["Ix"]
    damping = entry["d_roll"]
    leans = entry["leans"]
    return {
        "friction": ParameterSpec(friction, 0.3, 1.1, "1", True, SOURCE, tied),
        "tread_stiffness": _scaled(columns["cp"], 0.3, 3.0, "N/m^2", tied),
        "contact_half_length": _scaled(columns["l"], 0.5, 1.7, "m", tied),
        "yaw_inertia": _scaled(entry["Iz"], 0.5, 2.5, "kg m^2"),
        "roll_inertia": ParameterSpec(roll_inertia, swing, 2 * swing, "kg m^2", True, SOURCE)
        if leans
        else _constant(roll_inertia, "kg m^2"),
        "aligning_gain": ParameterSpec(entry["k_align"], 0.0, 3.0, "1", True, SOURCE),
        "yaw_damping": ParameterSpec(entry["d_yaw"], 0.0, 8.0, "1/s", True, SOURCE),
        "roll_damping": _scaled(damping, 0.375, 2.5, "N m s")
        if leans
        else _constant(damping, "N m s"),
        "length_scale": _constant(1.0, "1"),
        "rolling_resistance": _constant(0.0, "1"),
        "drag": _constant(0.0, "N s^2/m^2"),
    }


def _require_complete(entry: Mapping[str, Any], where: str) -> None:
    for key in (*_SCALARS, "control", "leans", "balanced", "wheels"):
        require(key in entry, key, "be given", "nothing", where)
    for key, name in {"m": "mass_kg", "h": "height_m", "Iz": "yaw_inertia"}.items():
        require_positive(name, entry[key], where)
    columns = entry["wheels"]
    for key in _WHEEL_COLUMNS:
        require(key in columns, f"wheels.{key}", "be given", "nothing", where)
        count = len(columns["x"])
        require(
            len(columns[key]) == count,
            f"wheels.{key}",
            f"have {count} entries",
            len(columns[key]),
            where,
        )
    for position in columns["x"]:
        axle = entry["lf"] if position > 0 else -entry["lr"]
        require(
            abs(position - axle) < 1e-6,
            "wheels.x",
            f"be lf = {entry['lf']:g} or -lr = {-entry['lr']:g}",
            f"{position:g}",
            where,
            "Two axles need a wheelbase lf + lr above zero.",
        )


def fields_from_reference(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Read the fields of a `VehicleSpec` from a parameter set under the papers' symbols (SI).

    Ranges are the physical ones of each symbol: μ 0.3 to 1.1, c_p 0.3 to 3 times the value, ℓ 0.5
    to 1.7 times, and so on; limits of speed and acceleration, which such a set does not hold,
    follow from friction.

    Raises:
        ValueError: A key is missing, a column has another length, or the wheels do not stand on
            the axles.
    """
    where = f"for vehicle '{entry.get('name', '?')}'"
    _require_complete(entry, where)
    columns = entry["wheels"]
    length = entry["lf"] + entry["lr"]
    grip = 9.81 * min(columns["mu"])
    track = max(columns["y"]) - min(columns["y"])
    return {
        "name": entry.get("name", "unnamed"),
        "mode": "unknown",
        "mass_kg": entry["m"],
        "height_m": entry["h"],
        "wheelbase": _scaled(length or entry["L_virtual"], 0.85, 1.15, "m"),
        "limits": Limits(
            12.0, -0.75 * grip, 0.5 * grip, entry["delta_max"], 2.5, entry["gamma_max"]
        ),
        "footprint": FootprintSpec(length + _OVERHANG_M, max(track, _WIDTH_M)),
        "wheels": _wheels(columns),
        "steering": _steering(entry),
        "parameters": _parameters(entry),
        "leans": bool(entry["leans"]),
        "balanced": bool(entry["balanced"]),
        "reverse": bool(entry.get("reverse", False)),
        "smoothing": Smoothing(entry["v_eps"], entry["v_stop"], entry["a_eps"], entry["q_max"]),
        "sources": {"all": SOURCE},
    }
