"""Whole recorded tracks of one mode, as motions, for system identification."""

import logging
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from torch import Tensor
from trajdata.caching.env_cache import EnvCache
from trajdata.data_structures.scene_metadata import Scene

from diffstack_mmv.checks import message, require
from diffstack_mmv.data.batch import STANDSTILL_MPS, yaw_rate
from diffstack_mmv.data.damage import only_file, told_as_damage
from diffstack_mmv.data.sources import ConvertedCache, WindowSource
from diffstack_mmv.geometry import rotate
from diffstack_mmv.types import Mode, Motion
from dmmv_conventions.cache import (
    CONTROLS_TABLE,
    LEAN_TABLE,
    SENSORS_TABLE,
    conversion_of,
    require_own,
    side_table,
)

logger = logging.getLogger(__name__)


class RecordedNoise(NamedTuple):
    """Standard deviation of the recorded position of one step, along and across the motion."""

    along_m: float
    across_m: float


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


def read_tracks(source: WindowSource, splits: Sequence[str], mode: str) -> dict[str, Motion]:
    """Read all tracks of a mode, without cutting windows out of them.

    Args:
        source: A cache that scripts/convert.py wrote.
        splits: Splits to read.
        mode: Mode of transport.

    Returns:
        Motion (T) of each track in the world by "recording/agent", float64, steps of the cache.

    Raises:
        ValueError: The mode is unknown, or the source is no finished converted cache or holds no
            track of that mode.
    """
    cache = _converted(source)
    wanted, found = Mode.named(mode), {}
    for scene in cache.scenes():
        if scene["split"] in splits and scene.get("agents", {wanted.label: 1}).get(wanted.label):
            found |= _scene_tracks(cache, scene["name"], wanted)
    remedy = "Choose another data set or another vehicle."
    where = f"in the splits {', '.join(splits)} of '{cache.name}'"
    require(len(found) > 0, "mode", "have tracks", f"none of mode '{mode}'", where, remedy)
    return found


def read_interpolated(source: WindowSource, splits: Sequence[str], mode: str) -> dict[str, Tensor]:
    """Which steps of each track lie in a gap of the recording, beside `read_tracks`.

    Returns:
        By "recording/agent" a mask (T) of the rows that were bridged, not measured.

    Raises:
        ValueError: The mode is unknown, or the source is no finished converted cache.
    """
    cache, wanted, found = _converted(source), Mode.named(mode), {}
    for scene in cache.scenes():
        if scene["split"] not in splits or not scene.get("agents", {wanted.label: 1}).get(
            wanted.label
        ):
            continue
        for agent, rows in _agent_rows(cache, scene["name"]).groupby("agent_id"):
            mask = rows["interpolated"].to_numpy(dtype=bool)
            found[f"{scene['name']}/{agent}"] = torch.from_numpy(mask.copy())
    return found


def read_leans(source: WindowSource, splits: Sequence[str], mode: str) -> dict[str, Tensor]:
    """Measured lean of the tracks that have one, beside `read_tracks`.

    Returns:
        Lean (T) in rad, positive to the left, by "recording/agent"; NaN where it was not measured.

    Raises:
        ValueError: The mode is unknown, or the source is no finished converted cache.
    """
    cache, found = _converted(source), {}
    for scene in cache.scenes():
        table = side_table(_folder(cache, scene["name"]), LEAN_TABLE)
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
        else a value between its neighbors; NaN before the first and after the last record.

    Raises:
        ValueError: The mode is unknown, the source is no finished converted cache, no scene has
            such a table, or one lacks a column.
    """
    return _recorded(_converted(source), splits, Mode.named(mode), names, CONTROLS_TABLE)


def read_sensors(
    source: WindowSource, splits: Sequence[str], mode: str, names: Sequence[str]
) -> dict[str, Tensor]:
    """Measurements of sensors, such as `yaw_rate`, in the way of `read_controls`.

    They stand in `sensors.parquet` of a scene.

    Returns:
        By "recording/agent" the measurements (T, m); NaN before the first and after the last.

    Raises:
        ValueError: As `read_controls`.
    """
    return _recorded(_converted(source), splits, Mode.named(mode), names, SENSORS_TABLE)


def _recorded(
    cache: ConvertedCache, splits: Sequence[str], mode: Mode, names: Sequence[str], table: str
) -> dict[str, Tensor]:
    """Columns of a table that stands beside the scenes, over the steps of each track."""
    found, tables = {}, 0
    for scene in cache.scenes():
        path = side_table(_folder(cache, scene["name"]), table)
        if scene["split"] not in splits or not path.exists():
            continue
        tables, measured = tables + 1, _numbers(cache, path, names)
        found |= _scene_controls(cache, scene["name"], measured, mode, names)
    where, remedy = f" in '{cache.name}'", f"Write one beside the scenes, or drop `{table}`."
    require(tables > 0, table, f"be recorded in {table}.parquet", "no such file", where, remedy)
    known = any(bool(torch.isfinite(values).any()) for values in found.values())
    require(known, table, "hold a number at a time of a track", "none", where, remedy)
    return found


def _numbers(cache: ConvertedCache, path: Path, names: Sequence[str]) -> pd.DataFrame:
    """A table beside a scene: whose, when, and columns of numbers, NaN where there is none."""
    table = _side_rows(cache, path)
    columns, where = tuple(table.columns), f" in {path}"
    for name in ("agent_id", "time_s", *names):
        needs = f"be columns of {', '.join(columns)}"
        require(name in columns, path.stem, needs, name, where)
    for name in ("time_s", *names):
        kind = table[name].dtype
        require(kind.kind in "fiu", path.stem, f"be numbers in column {name}", kind, where)
        finite = not np.isinf(table[name].to_numpy("float64")).any()
        require(finite, path.stem, f"be finite in column {name}", "inf", where)
    return table


def _side_rows(cache: ConvertedCache, path: Path) -> pd.DataFrame:
    with told_as_damage(path, conversion_of(cache.name, Path(cache.folder))):
        return pd.read_parquet(path)


def _agent_rows(cache: ConvertedCache, name: str) -> pd.DataFrame:
    """All rows of a scene, in the order of time."""
    path = only_file(_folder(cache, name), "agent_data_dt*.feather")
    with told_as_damage(path, conversion_of(cache.name, Path(cache.folder))):
        return pd.read_feather(path).sort_values("scene_ts")


def _scene(cache: ConvertedCache, name: str) -> Scene:
    path = only_file(_folder(cache, name), "scene_metadata_dt*.dill")
    with told_as_damage(path, conversion_of(cache.name, Path(cache.folder))):
        return EnvCache.load(path)


def recorded_noise(source: WindowSource, mode: str, dt_s: float) -> RecordedNoise | None:
    """Noise of the positions of a mode, as the conversion report tells it.

    The report knows the noise σ of a recorded position from what the smoother left over and from
    the share of white noise that it takes up. The tracks have other steps than the recording: with
    σ (recorded step / dt)^½ for each of them they say as much about a path as the recording did.

    Args:
        source: A cache that scripts/convert.py wrote.
        mode: Mode of transport.
        dt_s: Step of the tracks in s.

    Raises:
        ValueError: The source is no converted cache.
    """
    cache = _converted(source)
    told = cache.report().get("totals", {}).get("smoother_residual", {}).get(mode)
    if told is None:
        return None
    if "step_s" not in told:
        logger.warning(
            "The report of '%s' tells no noise, only what the smoother left over, which is less "
            "where samples are sparse. Convert again, or set `noise`.",
            cache.name,
        )
        return RecordedNoise(told["along_m"], told["across_m"])
    share = math.sqrt(told["step_s"] / dt_s)
    return RecordedNoise(share * told["noise_along_m"], share * told["noise_across_m"])


def _converted(source: WindowSource) -> ConvertedCache:
    if not isinstance(source, ConvertedCache):
        wanted = "be a cache written by scripts/convert.py"
        raise ValueError(message("data", wanted, type(source).__name__, "", "Convert it first."))
    folder = Path(source.folder)
    require_own(folder / source.name, conversion_of(source.name, folder))
    return source


def _scene_tracks(cache: ConvertedCache, name: str, mode: Mode) -> dict[str, Motion]:
    scene = _scene(cache, name)
    chosen = [agent.name for agent in scene.agents or () if int(agent.type) == mode]
    table = _agent_rows(cache, name)
    return {
        f"{name}/{agent}": _motion(table[table["agent_id"] == agent], scene.dt) for agent in chosen
    }


def _scene_leans(cache: ConvertedCache, name: str, table: Path, mode: Mode) -> dict[str, Tensor]:
    """Lean at the steps of each track, between the times of measurement by straight lines."""
    found = {}
    for track in _measured(cache, name, _numbers(cache, table, ["lean"]), mode):
        known = (track.rows["time_s"].to_numpy(), track.rows["lean"].to_numpy())
        lean = np.interp(track.time_s, *known, left=np.nan, right=np.nan)
        found[track.name] = torch.from_numpy(lean)
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
        between = np.stack(
            [np.interp(middle, time_s, column, left=np.nan, right=np.nan) for column in values.T], 1
        )
        found[track.name] = torch.from_numpy(np.where(np.isnan(means), between, means))
    return found


class _Measured(NamedTuple):
    """What was measured of one track."""

    name: str
    time_s: np.ndarray  # (T,) of its steps
    rows: pd.DataFrame  # in the order of time


def _measured(
    cache: ConvertedCache, name: str, table: pd.DataFrame, mode: Mode
) -> Iterator[_Measured]:
    """Rows of a table that stands beside a scene, by the tracks of a mode."""
    scene = _scene(cache, name)
    for agent in scene.agents or ():
        # a track that was split at gaps has one measurement for all its parts
        whose = table["agent_id"].isin([agent.name, agent.name.rpartition("_s")[0]])
        rows = table[whose].sort_values("time_s")
        if int(agent.type) == mode and len(rows):
            time_s = np.arange(agent.first_timestep, agent.last_timestep + 1) * scene.dt
            yield _Measured(f"{name}/{agent.name}", time_s, rows)


def _folder(cache: ConvertedCache, scene: str) -> Path:
    return Path(cache.folder) / cache.name / scene


def _motion(rows: pd.DataFrame, dt_s: float) -> Motion:
    """Motion from rows x, y, vx, vy, heading of the smoothed track."""
    columns = rows.sort_values("scene_ts")[["x", "y", "vx", "vy", "heading"]].to_numpy("float64")
    state = torch.tensor(columns)
    position, velocity, heading = state[:, :2], state[:, 2:4], state[:, 4]
    moving = velocity.norm(dim=-1) >= STANDSTILL_MPS
    return Motion(position, heading, rotate(velocity, -heading), yaw_rate(heading, moving, dt_s))
