"""Units of the columns of a table, and the checks that tell a wrong one."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from data_converters.errors import require
from dmmv_conventions.checks import is_number, require_switch

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ft": 0.3048}
COMPASS = "compass_deg"
RADIANS = {
    "rad": (1.0, 0.0),
    "deg": (np.pi / 180.0, 0.0),
    COMPASS: (-np.pi / 180.0, np.pi / 2.0),
}
"""Factor to rad, and where zero points to, counter-clockwise from east."""
SPEEDS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
MARKS = {"point": ".", "comma": ","}
"""What separates the decimals of a number."""
SWAPPED = str.maketrans(",.", ".,")
TEXT_TIME = "iso"
"""Unit of a time that is written as date and time of day."""


@dataclass(frozen=True)
class TableUnits:
    """Units of a table.

    Attributes:
        time: s, ms, us, ns, or iso for text such as 2026-05-04T12:00:00.1.
        length: Of positions and sizes: m, cm, mm, km or ft.
        angle: Of the heading: rad or deg from x towards y, or compass_deg clockwise from north,
            which is up in a picture, too.
        speed: m/s, km/h or mph.
        decimal: point or comma, as numbers in text files are written.
        y_down: Whether y points down, as in a picture; turns would be mirrored.
        origin_m: Place in m, x and y (upwards), that is subtracted from all positions, such as a
            corner of the site in UTM.

    Raises:
        ConversionError: If a unit is not known, or the origin is no place.
    """

    time: str = "s"
    length: str = "m"
    angle: str = "rad"
    speed: str = "m/s"
    decimal: str = "point"
    y_down: bool = False
    origin_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        times = [*SECONDS, TEXT_TIME]
        for name, known in (
            ("time", times),
            ("length", list(METRES)),
            ("angle", list(RADIANS)),
            ("speed", list(SPEEDS)),
            ("decimal", list(MARKS)),
        ):
            value = getattr(self, name)
            fits = value in known
            require(
                fits, f"units.{name}", f"be one of {', '.join(known)}", value, "", "Choose one."
            )
        object.__setattr__(self, "origin_m", tuple(self.origin_m))
        numbers = [value for value in self.origin_m if is_number(value) and np.isfinite(value)]
        fits, needs = len(self.origin_m) == len(numbers) == 2, "be two numbers"
        remedy = "Give data.units.origin_m=[X,Y] in m."
        require(fits, "units.origin_m", needs, list(self.origin_m), "", remedy)
        require_switch("units.y_down", self.y_down)

    def settings(self) -> dict[str, object]:
        """All units as plain values."""
        return asdict(self)

    def numbers(self, values: pd.Series) -> pd.Series:
        """Numbers, also those in text; NaN where there is none."""
        if self.decimal == "comma" and not pd.api.types.is_numeric_dtype(values):
            values = values.where(values.isna(), values.astype(str).str.translate(SWAPPED))
        return pd.to_numeric(values, errors="coerce").astype(np.float64)

    def seconds(self, times: pd.Series) -> pd.Series:
        """Times in s; NaN where there is none."""
        if self.time == TEXT_TIME:
            stamps = pd.to_datetime(times, errors="coerce", format="ISO8601", utc=True)
            return (stamps - stamps.min()).dt.total_seconds()
        return self.numbers(times) * SECONDS[self.time]

    def metres(self, lengths: pd.Series) -> pd.Series:
        """Lengths in m; NaN where there is none."""
        return self.numbers(lengths) * METRES[self.length]

    def places(self, x: pd.Series, y: pd.Series) -> dict[str, pd.Series]:
        """Positions in m from the origin, x to the east and y to the north; NaN for none."""
        upwards = self.metres(y) * (-1.0 if self.y_down else 1.0)
        return {"x": self.metres(x) - self.origin_m[0], "y": upwards - self.origin_m[1]}

    @property
    def mirrored(self) -> bool:
        """Whether headings turn the other way because y points down; a compass never does."""
        return self.y_down and self.angle != COMPASS

    def radians(self, angles: pd.Series) -> pd.Series:
        """Angles in rad, counter-clockwise from east."""
        factor, zero = RADIANS[self.angle]
        turned = self.numbers(angles) * factor + zero
        return -turned if self.mirrored else turned

    def metres_per_second(self, speeds: pd.Series) -> pd.Series:
        """Speeds in m/s; NaN where there is none."""
        return self.numbers(speeds) * SPEEDS[self.speed]


@dataclass(frozen=True)
class Plausibility:
    """What a table with the right units looks like.

    Attributes:
        rate_hz: Samples per second of an agent; None: between the slowest and the fastest.
        tolerance: Largest relative deviation from `rate_hz`.
        slowest_hz: Slowest rate that can be used.
        fastest_hz: Fastest rate that is believed.
        max_speed_mps: Speed in m/s that the median of the agents does not exceed.

    Raises:
        ConversionError: If a number is not positive.
    """

    rate_hz: float | None = None
    tolerance: float = 0.05
    slowest_hz: float = 1.0
    fastest_hz: float = 1000.0
    max_speed_mps: float = 60.0

    def __post_init__(self) -> None:
        for name in ("rate_hz", "tolerance", "slowest_hz", "fastest_hz", "max_speed_mps"):
            value = getattr(self, name)
            require(value is None or value > 0.0, name, "be positive", value, "", "Give Hz or m/s.")

    def check(self, table: pd.DataFrame, where: object) -> None:
        """Refuse a table whose usual step or speed cannot be.

        Args:
            table: Columns agent, time_s, x, y.
            where: The file, for messages.

        Raises:
            ConversionError: The message tells the setting that is likely to be wrong.
        """
        usual = _usual(table)
        if len(usual) == 0:
            return
        rate, speed = float(1.0 / usual["step"].median()), float(usual["speed"].median())
        if self.rate_hz is None:
            needs = f"be between {self.slowest_hz:g} and {self.fastest_hz:g} Hz"
            fits = self.slowest_hz <= rate <= self.fastest_hz
        else:
            needs = f"be {self.rate_hz:g} Hz"
            fits = abs(rate / self.rate_hz - 1.0) <= self.tolerance
        remedy = "Check data.units.time, the column of the time, and data.rate_hz."
        require(fits, "rate", needs, f"{rate:.4g} Hz", where, remedy)
        needs = f"stay below {self.max_speed_mps:g} m/s in the median of the agents"
        remedy = "Check data.units.length and data.units.time."
        fits = speed <= self.max_speed_mps
        require(fits, "speed", needs, f"{speed:.4g} m/s", where, remedy)


def _usual(table: pd.DataFrame) -> pd.DataFrame:
    """Median step in s and median speed in m/s of each agent that has any."""
    ordered = table[["agent", "time_s", "x", "y"]].dropna().sort_values(["agent", "time_s"])
    moves = ordered.groupby("agent")[["time_s", "x", "y"]].diff()
    moves = moves.assign(agent=ordered["agent"])[moves["time_s"] > 0.0]
    speed = np.hypot(moves["x"], moves["y"]) / moves["time_s"]
    return (
        moves.assign(step=moves["time_s"], speed=speed).groupby("agent")[["step", "speed"]].median()
    )
