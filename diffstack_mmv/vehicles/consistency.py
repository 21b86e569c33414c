"""Whether the numbers of a vehicle fit each other: parameters, units, wheelbase and inertia."""

from collections.abc import Mapping, Sequence

from diffstack_mmv.vehicles.layout import steered_length_m
from diffstack_mmv.vehicles.parts import (
    BODY_PARAMETERS,
    WHEEL_PARAMETERS,
    FootprintSpec,
    WheelSpec,
)
from diffstack_mmv.vehicles.quantity import ParameterSpec
from dmmv_conventions.checks import require, require_at_least, require_positive

WHEELBASE_APART = 1.5  # times what the wheels say, or a part of it; calibrated ones differ by less
FOOTPRINTS_OF_GYRATION = 50.0  # a mass as near to its middle as this part of the footprint is none
FOOTPRINTS_MAX = 10.0  # a length beyond is in another unit than metres
_ROUNDED = 5e-3  # relative, of what a file gives in two or three digits
_POSITIVE = (
    "friction",
    "tread_stiffness",
    "contact_half_length",
    "yaw_inertia",
    "roll_inertia",
    "length_scale",
)
_CONVERT = "Convert initial, low and high."


def require_metres(footprint: FootprintSpec, lengths: Mapping[str, float], where: str) -> None:
    """Refuse lengths in centimetres or millimetres: out of all proportion to the footprint.

    Raises:
        ValueError: A length is more than `FOOTPRINTS_MAX` times the footprint.
    """
    longest = max(footprint.length_m, footprint.width_m)
    for key, length in lengths.items():
        require(
            abs(length) <= FOOTPRINTS_MAX * longest,
            key,
            f"be at most {FOOTPRINTS_MAX:g} times the footprint of {longest:g} m",
            f"{abs(length):g}",
            where,
            "Give metres.",
        )


def require_parameters(
    parameters: Mapping[str, ParameterSpec], wheel_count: int, where: str
) -> None:
    """Refuse parameters that are missing, unknown, of another unit, length or sign.

    Raises:
        ValueError: One of them is.
    """
    known = WHEEL_PARAMETERS | BODY_PARAMETERS
    for name, unit in known.items():
        place = f"parameters.{name}"
        require(name in parameters, place, "be given", "nothing", where)
        parameter = parameters[name]
        _require_unit(place, parameter, unit, where)
        found = f"{parameter.length} entries"
        if name in WHEEL_PARAMETERS:
            fits = parameter.length in (None, wheel_count)
            remedy = f"The vehicle has {wheel_count} wheels."
            require(fits, place, "be one number, or one per wheel", found, where, remedy)
        else:
            require(parameter.length is None, place, "be one number", found, where)
        for _, low, _ in parameter.entries():
            if name in _POSITIVE:
                require_positive(f"{place}.low", low, where)
            else:
                require_at_least(f"{place}.low", low, 0.0, where)
    for name in parameters:
        wanted = f"be one of {', '.join(known)}"
        require(name in known, f"parameters.{name}", wanted, "an unknown name", where)


def require_wheelbase(wheelbase: ParameterSpec, where: str) -> None:
    """Refuse several wheelbases, one in another unit than metres, or one that may be zero.

    Raises:
        ValueError: It is.
    """
    _require_unit("wheelbase", wheelbase, "m", where)
    found = f"{wheelbase.length} entries"
    require(wheelbase.length is None, "wheelbase", "be one number", found, where)
    ((_, low, _),) = wheelbase.entries()
    remedy = "A vehicle with one axle takes a virtual wheelbase."
    require_positive("wheelbase.low", low, where, remedy)


def require_wheelbase_of_wheels(
    wheelbase: ParameterSpec, wheels: Sequence[WheelSpec], where: str
) -> None:
    """Refuse a wheelbase far from that of the wheels.

    Raises:
        ValueError: It is more than `WHEELBASE_APART` times too long or too short.
    """
    length, (_, low, high) = steered_length_m(wheels), wheelbase.entries()[0]
    require(
        length == 0 or low / WHEELBASE_APART <= length <= high * WHEELBASE_APART,
        "wheelbase",
        f"fit the wheels, which steer as a bicycle of {length:g} m",
        f"low = {low:g} and high = {high:g}",
        where,
        "Measure from the steered axle to the one that does not steer.",
    )


def require_roll_inertia(
    roll_inertia: ParameterSpec, mass_kg: float, height_m: float, where: str
) -> None:
    """Refuse a roll inertia of a leaning vehicle below m h², that of a point on a rod.

    Raises:
        ValueError: It is, by more than rounding.
    """
    swing = mass_kg * height_m**2
    require(
        roll_inertia.entries()[0][0] >= swing * (1 - _ROUNDED),
        "parameters.roll_inertia.initial",
        f"be at least m h² = {swing:g} of a leaning vehicle",
        roll_inertia.initial,
        where,
        "It is that about the line on the ground.",
    )


def require_yaw_inertia(
    yaw_inertia: ParameterSpec, mass_kg: float, footprint: FootprintSpec, where: str
) -> None:
    """Refuse a yaw inertia or a mass in another unit: no such mass lies within the footprint.

    Raises:
        ValueError: The radius of gyration is longer than the footprint, or next to nothing.
    """
    high = mass_kg * (footprint.length_m**2 + footprint.width_m**2)
    low = high / FOOTPRINTS_OF_GYRATION**2
    inertia = yaw_inertia.entries()[0][0]
    require(
        low <= inertia <= high,
        "parameters.yaw_inertia.initial",
        f"lie between {low:.3g} and {high:.3g} for a mass of {mass_kg:g} kg on the footprint",
        inertia,
        where,
        "Give kg for the mass, kg m^2 for the inertia.",
    )


def require_footprint_of_wheels(
    footprint: FootprintSpec, wheels: Sequence[WheelSpec], where: str
) -> None:
    """Refuse a footprint that wheels stand out of, or one in another unit than their positions.

    Raises:
        ValueError: It is smaller than the way between its outermost wheels, or more than
            `FOOTPRINTS_MAX` times as large.
    """
    spans = [
        max(positions) - min(positions)
        for positions in ([w.x_m for w in wheels], [w.y_m for w in wheels])
    ]
    sizes = {"length_m": footprint.length_m, "width_m": footprint.width_m}
    most = FOOTPRINTS_MAX * max(spans)
    for (key, size), least in zip(sizes.items(), spans, strict=True):
        require(
            least * (1 - _ROUNDED) <= size <= most,
            f"footprint.{key}",
            f"lie between {least:g}, as far as the wheels are apart, and {most:g}",
            size,
            where,
            "Give metres, and the outline of vehicle and rider.",
        )


def _require_unit(place: str, parameter: ParameterSpec, unit: str, where: str) -> None:
    found = repr(parameter.unit)
    require(parameter.unit == unit, f"{place}.unit", f"be '{unit}'", found, where, _CONVERT)
