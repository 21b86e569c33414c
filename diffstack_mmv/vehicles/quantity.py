"""A physical quantity as the file of a vehicle tells it; needs no tensor."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dmmv_conventions.checks import require, require_switch

Numbers = float | tuple[float, ...]
_ROUNDING = 1e-6  # relative, of numbers that were kept in single precision
_EDGE = 1e-6  # an estimate at the very edge of its range is moved inside by this share of the range
_RESOLVED = 0.5 * _EDGE  # less is next to nothing in single precision, and such a wheelbase zero


def as_numbers(values: float | Sequence[float]) -> Numbers:
    """Return a float, or a tuple of floats for a sequence."""
    if isinstance(values, Sequence):
        return tuple(float(value) for value in values)
    return float(values)


def _broadcast(values: Numbers, length: int) -> tuple[float, ...]:
    return values if isinstance(values, tuple) else (values,) * length


def _require_range(initial: float, low: float, high: float) -> None:
    """Refuse a prior that its range does not hold, or does not resolve.

    Raises:
        ValueError: It is one.
    """
    require(math.isfinite(low) and math.isfinite(high), "low, high", "be finite", (low, high))
    require(low <= high, "low", f"be at most high = {high:g}", low)
    if low == initial == high:
        return
    remedy = "Widen the range, or set low = initial = high for a constant."
    wanted = f"lie between low = {low:g} and high = {high:g}"
    require(low < initial < high, "initial", wanted, initial, remedy=remedy)
    wanted = f"lie inside of its range by {_RESOLVED:g} of it, or single precision loses it"
    require(
        min(initial - low, high - initial) >= _RESOLVED * (high - low),
        "initial",
        wanted,
        f"{initial:g} between low = {low:g} and high = {high:g}",
        remedy="Narrow the range to what is possible.",
    )


@dataclass(frozen=True)
class ParameterSpec:
    """A physical quantity with its prior value, range, unit and source.

    Args:
        initial: Prior value, one number or one per wheel.
        low: Lower end of the range; `low == high` makes the parameter a constant.
        high: Upper end of the range.
        unit: SI unit, "1" for a dimensionless number.
        learn: Whether training may move it.
        source: Where the number comes from.
        tied: Whether wheels move together (one learned number) or each for itself.

    Raises:
        ValueError: A number is not finite, outside of its range or so near to an end of a wide one
            that single precision cannot tell them apart, or the lengths differ; unit or source is
            missing.
    """

    initial: Numbers
    low: Numbers
    high: Numbers
    unit: str
    learn: bool
    source: str
    tied: bool = False

    def __post_init__(self) -> None:
        lengths = {
            len(field) for field in (self.initial, self.low, self.high) if isinstance(field, tuple)
        }
        require(
            len(lengths) <= 1,
            "initial, low, high",
            "have the same number of entries",
            sorted(lengths),
            remedy="Give one number for all wheels, or one per wheel.",
        )
        for flag in ("learn", "tied"):
            require_switch(flag, getattr(self, flag))
        for initial, low, high in self.entries():
            _require_range(initial, low, high)
        require(
            bool(self.unit),
            "unit",
            "be given",
            "nothing",
            remedy='Write the SI unit, "1" for a plain number.',
        )
        require(
            bool(self.source),
            "source",
            "be given",
            "nothing",
            remedy="Say where the number comes from.",
        )

    @property
    def length(self) -> int | None:
        """Number of entries, None for a single number."""
        sized = [field for field in (self.initial, self.low, self.high) if isinstance(field, tuple)]
        return len(sized[0]) if sized else None

    def entries(self) -> list[tuple[float, float, float]]:
        """One (initial, low, high) per entry."""
        length = self.length or 1
        columns = (_broadcast(field, length) for field in (self.initial, self.low, self.high))
        return list(zip(*columns, strict=True))

    def with_value(self, value: float | Sequence[float], source: str) -> "ParameterSpec":
        """Return the same parameter with another prior; a constant takes it as its whole range.

        Raises:
            ValueError: The number of values does not fit, or a value lies outside of the range by
                more than rounding.
        """
        values = _broadcast(as_numbers(value), self.length or 1)
        count = self.length or 1
        wanted = f"have {count} entries" if self.length else "be one number"
        require(len(values) == count, "value", wanted, f"{len(values)} of them")
        moved = [
            _within(new, low, high)
            for new, (_, low, high) in zip(values, self.entries(), strict=True)
        ]
        initial, low, high = zip(*moved, strict=True) if self.length else moved[0]
        return ParameterSpec(initial, low, high, self.unit, self.learn, source, self.tied)


def _within(new: float, low: float, high: float) -> tuple[float, float, float]:
    """A new prior just inside of its range, and that range: of a constant, the prior alone."""
    if low == high:
        value = low if math.isclose(new, low, rel_tol=_ROUNDING) else new
        return value, value, value
    slack = _ROUNDING * max(high - low, abs(new))
    require(
        low - slack <= new <= high + slack,
        "value",
        f"lie between low = {low:g} and high = {high:g}",
        new,
        remedy="Widen the range of the vehicle.",
    )
    margin = _EDGE * (high - low)
    return min(max(new, low + margin), high - margin), low, high
