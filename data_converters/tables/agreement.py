"""Whether what a table says of an agent agrees with its path; where not, a unit is wrong."""

from __future__ import annotations

import numpy as np
import pandas as pd

from data_converters.errors import require
from data_converters.tables.columns import Plain, TableColumns
from data_converters.tables.units import RADIANS, TableUnits
from dmmv_conventions.modes import Mode

SPAN_S = 1.0
"""Time over which a course and a speed are taken, so that noise of positions hides neither."""
LONGEST_SPAN_S = 2.0
"""Across a longer gap nobody knows the course."""
MOVING_MPS = 1.0
"""Speed from which on an agent has a course."""
MOST = 0.75
"""Share of its rows in which an agent says that it moves, for it to be believed."""
ENOUGH_ROWS = 20
"""Moving rows from which on a median is believed."""
TURN_SLACK = 1.01
"""Factor by which a heading may exceed a full turn."""
FEW = 0.01
"""Share of rows that may hold nonsense: it costs their agents alone."""
LARGEST_ANGLE_DEG = 45.0
"""Largest median angle between heading and course."""
LARGEST_RATIO = 2.0
"""Largest median ratio of two speeds of an agent, either way."""
SIDEWAYS = (Mode.UNKNOWN, Mode.PEDESTRIAN, Mode.SKATEBOARD, Mode.STROLLER)
"""Modes that need not face where they go."""
DEGREES = (180.0, 90.0)
"""Largest longitude and latitude."""
CREEP_PER_S = 1e-3
"""Even an airplane covers fewer degrees in a second; nobody travels so few metres."""
STRAIGHT = 0.5
"""Least ratio of the way from end to end to the way in steps for who travels, not trembles."""


def require_agreement(
    table: pd.DataFrame, columns: TableColumns, units: TableUnits, where: object
) -> None:
    """Refuse a table whose headings, speeds or positions cannot have the units that are set.

    Args:
        table: Columns agent, time_s, x, y, mode and, where recorded, heading and speed; SI units.
        columns: Their names in the file, for messages.
        units: The units that were assumed.
        where: The file, for messages.

    Raises:
        ConversionError: The message tells the setting that is likely to be wrong.
    """
    if "heading" in table:
        _require_turns(table["heading"], columns, units, where)
    steps = _steps(table)
    _require_metres(table, steps, where)
    moving = steps[steps["speed"] >= MOVING_MPS]
    if "heading" in table:
        _require_course(moving, columns, where)
    if "speed" in table:
        few = len(moving) < ENOUGH_ROWS
        _require_speed(_said_to_move(steps) if few else moving, columns, units, where)


def _said_to_move(steps: pd.DataFrame) -> pd.DataFrame:
    """All rows of agents that say in most of them that they move, wherever positions hardly do.

    Single rows above the threshold would be those in which noise is high.
    """
    usual = steps["stated"].abs().groupby(steps["agent"]).transform("quantile", 1.0 - MOST)
    return steps[usual >= MOVING_MPS]


def _require_turns(
    heading: pd.Series, columns: TableColumns, units: TableUnits, where: object
) -> None:
    """A heading is at most a full turn, in the unit of the file."""
    factor, zero = RADIANS[units.angle]
    turned = heading * (-1.0 if units.mirrored else 1.0)
    stated = ((turned - zero) / factor).abs().replace(np.inf, np.nan).dropna()
    turn = 2.0 * np.pi / abs(factor)
    beyond = stated[stated > TURN_SLACK * turn]
    fits = len(beyond) <= FEW * len(stated)
    needs = f"have headings of at most {turn:.4g} {units.angle}"
    found = f"{stated.max():.4g} in column {columns.heading}"
    remedy = "Set data.units.angle=deg or compass_deg, or write headings within a turn."
    require(fits, "heading", needs, Plain(found), where, remedy)


def _require_course(moving: pd.DataFrame, columns: TableColumns, where: object) -> None:
    """Vehicles face where they go, by and large."""
    rows = moving[~moving["mode"].isin([float(mode) for mode in SIDEWAYS])]
    rows = rows.dropna(subset=["mode", "heading"])
    if len(rows) < ENOUGH_ROWS:
        return
    turn = rows["heading"] - rows["course"]
    usual = float(np.degrees(np.median(np.abs(np.arctan2(np.sin(turn), np.cos(turn))))))
    needs = f"differ from the course by at most {LARGEST_ANGLE_DEG:g} deg in the median"
    found = f"{usual:.0f} deg in column {columns.heading}"
    remedy = "Check data.units.angle, data.units.y_down, and the columns of heading, x and y."
    require(usual <= LARGEST_ANGLE_DEG, "heading", needs, Plain(found), where, remedy)


def _require_speed(
    moving: pd.DataFrame, columns: TableColumns, units: TableUnits, where: object
) -> None:
    """A recorded speed is about that of the positions."""
    ratios = (moving["stated"].abs() / moving["speed"]).dropna()
    if len(ratios) < ENOUGH_ROWS:
        return
    ratio = float(ratios.median())
    needs = f"be that of the positions within a factor of {LARGEST_RATIO:g} in the median"
    found = f"{ratio:.3g} times as much in column {columns.speed}, read as {units.speed}"
    remedy = "Set data.units.speed (a ratio of 3.6: km/h, of 2.2: mph), or check the units of x, y."
    fits = 1.0 / LARGEST_RATIO <= ratio <= LARGEST_RATIO
    require(fits, "speed", needs, Plain(found), where, remedy)


def _require_metres(table: pd.DataFrame, steps: pd.DataFrame, where: object) -> None:
    """Agents that all travel, but hardly, within the range of degrees are on a globe.

    Who stands still, or trembles by the noise of a sensor, does not travel.
    """
    places = table[["x", "y"]].abs().max()
    on_globe = places["x"] <= DEGREES[0] and places["y"] <= DEGREES[1]
    if not on_globe or len(steps) == 0 or steps["speed"].max() > CREEP_PER_S:
        return
    ways = steps.assign(way=np.hypot(steps["dx"], steps["dy"])).groupby("agent")
    sums = ways[["dx", "dy", "way"]].sum()
    ended = np.hypot(sums["dx"], sums["dy"])
    straight = pd.Series(ended / sums["way"].where(sums["way"] > 0.0)).dropna()
    fits = len(straight) == 0 or float(straight.median()) < STRAIGHT
    needs = "be in metres"
    low, high = table[["x", "y"]].min(), table[["x", "y"]].max()
    spread = f"x {low['x']:.6g} to {high['x']:.6g}, y {low['y']:.6g} to {high['y']:.6g}"
    found = f"{spread}, where the fastest covers {steps['speed'].max():.2g} in a second"
    remedy = "This looks like longitude and latitude: project them to metres (UTM, say) first."
    require(fits, "position", needs, Plain(found), where, remedy)


def _steps(table: pd.DataFrame) -> pd.DataFrame:
    """Way, speed and course over `SPAN_S` from each row, and what is stated in the middle of it."""
    named = ["agent", "time_s", "x", "y"]
    finite = table.replace([np.inf, -np.inf], np.nan).dropna(subset=named)
    ordered = finite.sort_values(["agent", "time_s"], kind="stable")
    parts = [_steps_of(rows) for _, rows in ordered.groupby("agent", sort=False)]
    return pd.concat(parts, ignore_index=True) if parts else _steps_of(ordered)


def _steps_of(rows: pd.DataFrame) -> pd.DataFrame:
    time, x, y = (rows[name].to_numpy(np.float64) for name in ("time_s", "x", "y"))
    first = np.arange(len(time))
    last = np.searchsorted(time, time + SPAN_S - 1e-6)
    first, last = first[last < len(time)], last[last < len(time)]
    near = time[last] - time[first] <= LONGEST_SPAN_S
    first, last = first[near], last[near]
    dx, dy, passed = x[last] - x[first], y[last] - y[first], time[last] - time[first]
    middle = rows.iloc[(first + last) // 2]
    steps = middle[["agent", "mode"]].assign(
        dx=dx, dy=dy, speed=np.hypot(dx, dy) / passed, course=np.arctan2(dy, dx)
    )
    stated = {"heading": "heading", "speed": "stated"}
    return steps.assign(**{to: middle[name] for name, to in stated.items() if name in middle})
