"""In what the configurations of two runs differ."""

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from dmmv_conventions.targets import nodes


class Difference(NamedTuple):
    """A setting that differs; what one of the two lacks is None."""

    place: str  # dotted
    before: Any
    now: Any


def first_difference(
    before: Mapping[str, Any], now: Mapping[str, Any], apart: re.Pattern[str] | None = None
) -> Difference | None:
    """The outermost setting in which two configurations of a command differ, if there is one.

    The arguments are those of `differences`.
    """
    return next(differences(before, now, apart), None)


def differences(
    before: Mapping[str, Any], now: Mapping[str, Any], apart: re.Pattern[str] | None = None
) -> Iterator[Difference]:
    """The settings in which two configurations of a command differ, outer ones first.

    Paths below the folder of a run, `out`, are those below the same folder elsewhere.

    Args:
        before: One configuration, resolved, as plain containers.
        now: The other one.
        apart: Places that it matches may differ; by default none.
    """
    first, second = _settings(before, apart), _settings(now, apart)
    for place in sorted(first.keys() | second.keys(), key=lambda place: (place.count("."), place)):
        if first.get(place) != second.get(place):
            yield Difference(place, first.get(place), second.get(place))


def _settings(config: Mapping[str, Any], apart: re.Pattern[str] | None) -> dict[str, Any]:
    """Dotted place -> value."""
    out = str(config.get("out"))
    return {
        place: value.replace(out, "OUT") if isinstance(value, str) else value
        for place, value in nodes(dict(config))
        if place and not isinstance(value, Mapping) and not (apart and apart.match(place))
    }
