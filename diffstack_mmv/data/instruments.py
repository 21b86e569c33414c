"""What instruments measured along recorded tracks: controls, sensors and lean."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.data.converted import converted, scene_folder, scene_of, side_rows
from diffstack_mmv.data.sources import ConvertedCache, WindowSource
from diffstack_mmv.data.tracks import read_interpolated, read_tracks
from diffstack_mmv.types import Mode, Motion
from dmmv_conventions.cache import CONTROLS_TABLE, LEAN_TABLE, SENSORS_TABLE, side_table

LONGEST_GAP_S = 0.5
"""Gap between records that is bridged, as that between positions of a conversion."""
LONGEST_GAP_STEPS = 1.5
"""The same for rare records, in usual times from one to the next."""


class RecordedRides(NamedTuple):
    """All that is recorded of rides with instruments, by "recording/agent"."""

    motions: dict[str, Motion]
    controls: dict[str, Tensor]  # (T, 2): steer (rad), speed (m/s)
    sensors: dict[str, Tensor]  # (T, 1): yaw rate (rad/s)
    leans: dict[str, Tensor]  # (T), rad
    interpolated: dict[str, Tensor]  # (T)


def read_rides(source: WindowSource, splits: Sequence[str], mode: str) -> RecordedRides:
    """Tracks with the instruments that rode along, as identification wants them.

    Returns:
        Of each track over its T times the motion, steer and speed (T, 2), yaw rate (T, 1), lean
        (T), and where positions are interpolated (T).

    Raises:
        ValueError: As the functions for each of them.
    """
    place = source, splits, mode
    return RecordedRides(
        read_tracks(*place),
        read_controls(*place, ["steer", "speed"]),
        read_sensors(*place, ["yaw_rate"]),
        read_leans(*place),
        read_interpolated(*place),
    )


def read_leans(source: WindowSource, splits: Sequence[str], mode: str) -> dict[str, Tensor]:
    """Measured lean of the tracks that have one, beside `read_tracks`.

    Returns:
        Lean, of shape (T,), in rad, positive to the left, by "recording/agent"; NaN where it was
        not measured, as for controls.

    Raises:
        ValueError: The mode is unknown, or the source is no finished converted cache.
    """
    cache, found = converted(source), {}
    for scene in cache.scenes():
        table = side_table(scene_folder(cache, scene["name"]), LEAN_TABLE)
        if scene["split"] in splits and table.exists():
            found |= _scene_leans(cache, scene["name"], table, Mode.named(mode))
    return found


def read_controls(
    source: WindowSource, splits: Sequence[str], mode: str, names: Sequence[str]
) -> dict[str, Tensor]:
    """Recorded controls of the tracks that have them, beside `read_tracks`.

    They stand in `controls.parquet` of a scene with the columns `agent_id`, `time_s` (s, on the
    clock of the scene) and one column per control.

    Args:
        source: A cache that scripts/convert.py wrote.
        splits: Splits to read.
        mode: Mode of transport.
        names: Columns to read, in this order.

    Returns:
        By "recording/agent" the controls (T, m): the mean of what was recorded within each step,
        else a value between its neighbors; NaN before the first and after the last record, and
        between two that are farther apart than 0.5 s and 1.5 times the usual.

    Raises:
        ValueError: The mode is unknown, the source is no finished converted cache, no scene has
            such a table, or one lacks a column.
    """
    return _recorded(converted(source), splits, Mode.named(mode), names, CONTROLS_TABLE)


def read_sensors(
    source: WindowSource, splits: Sequence[str], mode: str, names: Sequence[str]
) -> dict[str, Tensor]:
    """Measurements of sensors, such as `yaw_rate`, in the way of `read_controls`.

    They stand in `sensors.parquet` of a scene; not every vehicle carries any.

    Returns:
        By "recording/agent" the measurements (T, m), NaN where there are none nearby; nothing where
        no scene has such a table.

    Raises:
        ValueError: As `read_controls`, but for a table that is not there.
    """
    place = converted(source), splits, Mode.named(mode), names
    return _recorded(*place, SENSORS_TABLE, needed=False)


def _recorded(
    cache: ConvertedCache,
    splits: Sequence[str],
    mode: Mode,
    names: Sequence[str],
    table: str,
    needed: bool = True,
) -> dict[str, Tensor]:
    """Columns of a table that stands beside the scenes, over the steps of each track."""
    found, tables = {}, 0
    for scene in cache.scenes():
        path = side_table(scene_folder(cache, scene["name"]), table)
        if scene["split"] not in splits or not path.exists():
            continue
        tables, measured = tables + 1, _numbers(cache, path, names)
        found |= _scene_controls(cache, scene["name"], measured, mode, names)
    where, remedy = f"in '{cache.name}'", f"Write one beside the scenes, or drop `{table}`."
    there = tables > 0 or not needed
    require(there, table, f"be recorded in {table}.parquet", "no such file", where, remedy)
    known = not tables or any(bool(torch.isfinite(values).any()) for values in found.values())
    require(known, table, "hold a number at a time of a track", "none", where, remedy)
    return found


def _numbers(cache: ConvertedCache, path: Path, names: Sequence[str]) -> pd.DataFrame:
    """A table beside a scene: whose, when, and columns of numbers, NaN where there is none."""
    table = side_rows(cache, path)
    columns, where = tuple(table.columns), f"in {path}"
    for name in ("agent_id", "time_s", *names):
        needs = f"be columns of {', '.join(columns)}"
        require(name in columns, path.stem, needs, name, where)
    for name in ("time_s", *names):
        kind = table[name].dtype
        require(kind.kind in "fiu", path.stem, f"be numbers in column {name}", kind, where)
        finite = not np.isinf(table[name].to_numpy("float64")).any()
        require(finite, path.stem, f"be finite in column {name}", "inf", where)
    return table


def _scene_leans(cache: ConvertedCache, name: str, table: Path, mode: Mode) -> dict[str, Tensor]:
    """Lean at the steps of each track, between the times of measurement by straight lines."""
    found = {}
    for track in _measured(cache, name, _numbers(cache, table, ["lean"]), mode):
        time_s, values = (track.rows[name].to_numpy("float64") for name in ("time_s", "lean"))
        found[track.name] = torch.from_numpy(_between(track.time_s, time_s, values))
    return found


def _scene_controls(
    cache: ConvertedCache, name: str, measured: pd.DataFrame, mode: Mode, names: Sequence[str]
) -> dict[str, Tensor]:
    """Controls over the steps of each track."""
    found = {}
    for track in _measured(cache, name, measured, mode):
        time_s, values = (
            track.rows["time_s"].to_numpy(),
            track.rows[list(names)].to_numpy("float64"),
        )
        dt_s = track.time_s[1] - track.time_s[0]
        middle = track.time_s + 0.5 * dt_s
        within = np.floor((time_s - track.time_s[0]) / dt_s + 1e-6).astype(int)
        means = pd.DataFrame(values).groupby(within).mean().reindex(range(len(middle))).to_numpy()
        between = np.stack([_between(middle, time_s, column) for column in values.T], 1)
        found[track.name] = torch.from_numpy(np.where(np.isnan(means), between, means))
    return found


def _between(at_s: np.ndarray, time_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Straight lines between the numbers among values (n,); NaN where none is near."""
    known = np.isfinite(time_s) & np.isfinite(values)
    if not known.any():
        return np.full(len(at_s), np.nan)
    time_s, values = time_s[known], values[known]
    found = np.interp(at_s, time_s, values, left=np.nan, right=np.nan)
    # what an instrument would have shown while it failed is not known
    steps_s = np.diff(time_s)
    usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    failed = np.flatnonzero(steps_s > max(LONGEST_GAP_S, LONGEST_GAP_STEPS * usual_s))
    at_s = at_s[:, None]
    inside = (at_s > time_s[failed]) & (at_s < time_s[failed + 1])
    return np.where(inside.any(-1), np.nan, found)


class _Measured(NamedTuple):
    """What was measured of one track."""

    name: str
    time_s: np.ndarray  # (T,) of its steps
    rows: pd.DataFrame  # in the order of time


def _measured(
    cache: ConvertedCache, name: str, table: pd.DataFrame, mode: Mode
) -> Iterator[_Measured]:
    """Rows of a table that stands beside a scene, by the tracks of a mode."""
    scene = scene_of(cache, name)
    by_name = {str(whose): rows for whose, rows in table.groupby("agent_id")}
    for agent in scene.agents or ():
        # a track that was split at gaps has one measurement for all its parts
        whose = agent.name if agent.name in by_name else re.sub(r"_s\d+$", "", agent.name)
        rows = by_name.get(whose, table[:0]).sort_values("time_s")
        if int(agent.type) == mode and len(rows):
            time_s = np.arange(agent.first_timestep, agent.last_timestep + 1) * scene.dt
            yield _Measured(f"{name}/{agent.name}", time_s, rows)
