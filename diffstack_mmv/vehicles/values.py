"""Single values of a vehicle's file: what is refused is told with its place in the file."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from typing import Any

from dmmv_conventions.checks import did_you_mean, message, require


def require_keys(
    mapping: Any, required: Collection[str], optional: Collection[str], path: str, where: str
) -> None:
    """Refuse what is no mapping, has a key that is not known, or lacks one.

    Args:
        mapping: What was read.
        required: Keys that it has to have.
        optional: Keys that it may have.
        path: Place of the mapping in the file, with a dot at its end ("limits.").
        where: The vehicle, with its preposition.

    Raises:
        ValueError: It does not fit; the message names the key that was meant.
    """
    require_mapping(mapping, path.rstrip(".") or "vehicle", where)
    known = [*required, *optional]
    for key in mapping:
        if key not in known:
            hint = did_you_mean(str(key), known, "`", 0.5) or "Remove it."
            needs = f"be one of {', '.join(known)}" if known else "be left out"
            raise ValueError(message(f"{path}{key}", needs, "an unknown key", where, hint))
    for key in required:
        require(key in mapping, f"{path}{key}", "be given", "nothing", where, f"Add `{key}`.")


def require_mapping(value: Any, path: str, where: str) -> None:
    """Refuse what is no mapping of keys.

    Raises:
        ValueError: It is none.
    """
    require(isinstance(value, Mapping), path, "be a mapping of keys", repr(value), where)


def number_at(value: Any, path: str, where: str) -> float:
    """A number as it stands in a file.

    Raises:
        ValueError: It is none.
    """
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


def whole_number_at(value: Any, path: str, where: str) -> int:
    """A whole number.

    Raises:
        ValueError: It is none.
    """
    number = number_at(value, path, where)
    require(number.is_integer(), path, "be a whole number", repr(value), where)
    return int(number)


def flag_at(value: Any, path: str, where: str) -> bool:
    """A truth value.

    Raises:
        ValueError: It is none.
    """
    require(isinstance(value, bool), path, "be true or false", repr(value), where)
    return value


def built_at(build: Callable[..., Any], arguments: Mapping[str, Any], path: str, where: str) -> Any:
    """What a class makes of arguments; what it refuses is told with its place.

    Raises:
        ValueError: The class refuses them.
    """
    try:
        return build(**arguments)
    except ValueError as problem:
        place = path.rstrip(".")
        raise ValueError(f"{problem} (`{place}` {where})") from problem


def record_at(kind: type, mapping: Any, path: str, where: str) -> Any:
    """Build a dataclass of numbers from a mapping with the same keys.

    Raises:
        ValueError: A key is unknown or missing, or a value is impossible.
    """
    known = {field.name: field for field in fields(kind)}
    given = [key for key, field in known.items() if field.default is field.default_factory]
    optional = [key for key in known if key not in given]
    require_keys(mapping, given, optional, path, where)
    arguments = {key: number_at(value, f"{path}{key}", where) for key, value in mapping.items()}
    return built_at(kind, arguments, path, where)
