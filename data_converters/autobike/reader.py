"""Reading of the logs of the Autobike: what its columns really hold, in SI units."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_converters.csv_table import read_numbers
from data_converters.errors import RejectReason, refuse_track

Array = NDArray[np.float64]

EARTH_RADIUS_M = 6_378_137.0
FIX_STEP_S = 0.1
"""Usual time between two positions."""

STANDING_RADPS = 0.1
"""Rate of the wheel in rad/s below which it stands."""

TIME, LATITUDE, LONGITUDE = "Time (ms)", "Lat GPS (deg)", "Long GPS (deg)"
STEER, WHEEL = "Steering Angle encoder(rad)", "Speed VESC (rad/s)"
ROLL_RATE, YAW_RATE = "Gyroscope X (rad/s)", "Gyroscope Z (rad/s)"
SIDEWAYS, ROLL = "Accelerometer Y (rad/s^2)", "State Estimate Roll (rad)"
COLUMNS = (TIME, LATITUDE, LONGITUDE, STEER, WHEEL, ROLL_RATE, YAW_RATE, SIDEWAYS, ROLL)
LARGEST = {
    TIME: np.inf, LATITUDE: 180.0, LONGITUDE: 360.0, STEER: np.pi, WHEEL: 300.0,
    ROLL_RATE: 100.0, YAW_RATE: 100.0, SIDEWAYS: 500.0, ROLL: np.pi,
}  # fmt: skip
"""Largest magnitude of a column that its instrument can tell."""


class Fixes(NamedTuple):
    """Satellite positions when they were new, and every 0.1 s while the wheel stands.

    Attributes:
        time_s: (n,) s, increasing.
        position: (n, 2) m, east and north of the first one.
    """

    time_s: Array
    position: Array


class Log(NamedTuple):
    """One log.

    Attributes:
        fixes: Positions, about ten per second.
        time_s: (m,) s on the same clock, increasing, about a hundred per second.
        sensors: (m) rows: steer_encoder (rad, about the inclined head axis, left positive),
            wheel_speed (rad/s), roll_rate, yaw_rate (rad/s, to the right, to the left positive),
            lateral_acceleration (m/s², gravity included, biased) and lean (rad, left positive, as
            the filter on board estimates it).
        repeated: Rows whose time is not later than the one before.
        unusable: Values that are no numbers, or none that the instrument can tell, which are NaN,
            and rows without a position.
    """

    fixes: Fixes
    time_s: Array
    sensors: pd.DataFrame
    repeated: int
    unusable: int


def read_log(path: Path) -> Log:
    """Read a log.

    Latitude and longitude are radians in spite of their header, 0 before the first fix, and
    repeated until there is a new one. The roll of the source is positive to the right.

    Raises:
        TrackError: If the file is no table, lacks a column, has no clock or no position.
    """
    table = read_numbers(path, COLUMNS, path)
    times = table[TIME].to_numpy() / 1e3
    so_far = np.fmax.accumulate(np.concatenate([[-np.inf], times[:-1]]))
    fresh = times > so_far
    if fresh.sum() < 2:
        needs, remedy, found = "increase", "The log has no clock.", times[:2]
        refuse_track(RejectReason.NO_TIMESTAMPS, TIME, needs, found, path, remedy)
    table, times = table[fresh], times[fresh]
    within = table.abs() <= pd.Series(LARGEST)[table.columns]
    lost = ((table[[LATITUDE, LONGITUDE]] == 0.0).any(axis=1)).sum()
    unusable = int((~within).sum().sum() + lost)
    table = table.where(within)
    sensors = pd.DataFrame(
        {
            "steer_encoder": table[STEER],
            "wheel_speed": table[WHEEL],
            "roll_rate": table[ROLL_RATE],
            "yaw_rate": table[YAW_RATE],
            "lateral_acceleration": table[SIDEWAYS],
            "lean": -table[ROLL],
        }
    )
    return Log(_fixes(table, times, path), times, sensors, int((~fresh).sum()), unusable)


def _fixes(table: pd.DataFrame, time_s: Array, path: Path) -> Fixes:
    angles = table[[LATITUDE, LONGITUDE]].to_numpy()
    known = np.isfinite(angles).all(axis=1) & (angles != 0.0).all(axis=1)
    changed = np.concatenate([[True], (np.diff(angles, axis=0) != 0.0).any(axis=1)])
    new = known & (changed | _resting(table[WHEEL].to_numpy(), changed, time_s))
    if new.sum() < 2:
        needs, remedy = "change while the bicycle rides", "The receiver had no fix."
        found = f"{int(new.sum())} positions"
        refuse_track(RejectReason.NO_POSITION, LATITUDE, needs, found, path, remedy)
    angles = angles[new]
    if np.abs(angles[:, 0]).max() > np.pi / 2.0:
        angles = np.deg2rad(angles)
    east, north = angles[:, 1] - angles[0, 1], angles[:, 0] - angles[0, 0]
    position = EARTH_RADIUS_M * np.column_stack([east * np.cos(angles[0, 0]), north])
    return Fixes(time_s[new], position)


def _resting(wheel: Array, changed: NDArray[np.bool_], time_s: Array) -> NDArray[np.bool_]:
    """Rows (m,) at rest in which a position is due that did not change."""
    since = time_s - time_s[np.maximum.accumulate(np.where(changed, np.arange(len(time_s)), 0))]
    number = np.floor(since / FIX_STEP_S + 1e-6)
    due = (number >= 1.0) & (np.diff(number, prepend=0.0) > 0.0)
    return due & (np.abs(wheel) < STANDING_RADPS)
