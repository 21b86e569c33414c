"""Errors of the converters: one class to catch, one wording, one reason per rejected track."""

from __future__ import annotations

from enum import StrEnum
from typing import NoReturn

from dmmv_conventions.checks import message


class RejectReason(StrEnum):
    """Why a track, or a stretch of it, is missing from the cache; keys of the report."""

    BROKEN_JSON = "broken_json"
    MISSING_FIELD = "missing_field"
    NO_TIMESTAMPS = "no_timestamps"
    TIMESTAMP_UNIT = "unknown_timestamp_unit"
    REPEATED_TIMESTAMPS = "repeated_timestamps"
    TWO_PLACES = "two_places_at_a_time"
    NOT_FINITE = "coordinates_not_finite"
    UNKNOWN_CLASS = "unknown_class_id"
    BROKEN_CUBOID = "broken_cuboid"
    LOW_STATUS = "status_below_minimum"
    LOW_PROBABILITY = "class_probability_below_minimum"
    CONTAINED = "contained_in_another_file"
    OTHER_SPLIT = "source_sequence_in_another_split"
    TOO_SHORT = "too_short"
    SCALE = "scale_unknown_or_beyond_limit"
    LOW_CERTAINTY = "scale_certainty_below_minimum"
    NO_POSITION = "no_position_fix"
    WHEEL_SPEED = "wheel_speed_disagrees_with_positions"
    GYRO = "gyro_disagrees_with_positions"
    UNREADABLE = "unreadable_file"
    REPEATED_FILE = "repeated_file"
    UNSAFE_MEMBER = "unsafe_archive_member"
    NO_ORIENTATION = "no_orientation"
    TIME_SPAN = "time_beyond_limit"
    COORDINATES = "coordinates_beyond_limit"
    EXTENT = "size_beyond_limit"
    SPEED = "faster_than_its_mode"
    NO_AGENT = "no_agent_name"
    NO_SCENE = "no_scene_name"
    OTHER_TABLE = "table_unlike_the_others"


class ConversionError(ValueError):
    """A recording, setting or cache cannot be used; the message names file, value, remedy."""


class CacheError(ConversionError):
    """A cache is missing, unfinished or of another version."""


class TrackError(ConversionError):
    """One track cannot be used.

    It is rejected and counted under `reason`, or raised when the conversion is strict.
    """

    def __init__(self, message: str, reason: RejectReason) -> None:
        super().__init__(message)
        self.reason = reason

    def __reduce__(self) -> tuple[type[TrackError], tuple[str, RejectReason]]:
        return type(self), (str(self), self.reason)


def require(
    condition: bool,
    argument: str,
    requirement: str,
    value: object,
    where: object = "",
    remedy: str = "",
    error: type[ConversionError] = ConversionError,
) -> None:
    """Refuse a setting, a data set or a cache; the arguments in the middle are those of `fault`.

    Raises:
        ConversionError: `condition` is false; of class `error`.
    """
    if not condition:
        raise error(f"{fault(argument, requirement, value, where, remedy)}")


def refuse_track(
    reason: RejectReason, argument: str, requirement: str, value: object, where: object, remedy: str
) -> NoReturn:
    """Refuse a track for a reason; the other arguments are those of `fault`.

    Raises:
        TrackError: Always.
    """
    raise TrackError(f"{fault(argument, requirement, value, where, remedy)}", reason)


def fault(argument: str, requirement: str, value: object, where: object, remedy: str) -> str:
    """Wording of an error about recordings, which can hold anything.

    Args:
        argument: Name of the argument, the column or the key at fault.
        requirement: What it must do or be.
        value: What was found; text is quoted, long values are cut.
        where: File or scene, "" where there is none.
        remedy: One sentence that says what to do.

    Returns:
        The message.
    """
    shown = repr(value) if isinstance(value, str) else str(value).strip()
    shown = shown if len(shown) <= 120 else f"{shown[:117]}..."
    return message(argument, requirement, shown, f"in {where}" if str(where) else "", remedy)
