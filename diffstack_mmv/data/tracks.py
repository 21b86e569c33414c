"""Whole recorded tracks of one mode, as motions, for system identification."""

import logging
import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import pandas as pd
import torch
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.data.converted import agent_rows, converted, scene_of
from diffstack_mmv.data.motions import STANDSTILL_MPS, yaw_rate
from diffstack_mmv.data.sources import ConvertedCache, WindowSource
from diffstack_mmv.geometry import rotate
from diffstack_mmv.types import Mode, Motion
from dmmv_conventions.cache import recordings_by_scene

logger = logging.getLogger(__name__)


class RecordedNoise(NamedTuple):
    """Standard deviation of the recorded position of one step, along and across the motion."""

    along_m: float
    across_m: float


def read_tracks(source: WindowSource, splits: Sequence[str], mode: str) -> dict[str, Motion]:
    """Read all tracks of a mode, without cutting windows out of them.

    Args:
        source: A cache that scripts/convert.py wrote.
        splits: Splits to read.
        mode: Mode of transport.

    Returns:
        Motion of each track by "recording/agent": position of shape (T, 2) in m, heading in rad,
        in the world, float64, steps of the cache.

    Raises:
        ValueError: The mode is unknown, or the source is no finished converted cache or holds no
            track of that mode.
    """
    cache = converted(source)
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
        By "recording/agent" a mask of shape (T,) of the rows that were bridged, not measured.

    Raises:
        ValueError: The mode is unknown, or the source is no finished converted cache.
    """
    cache, wanted, found = converted(source), Mode.named(mode), {}
    for scene in cache.scenes():
        if scene["split"] not in splits or not scene.get("agents", {wanted.label: 1}).get(
            wanted.label
        ):
            continue
        for agent, rows in agent_rows(cache, scene["name"]).groupby("agent_id"):
            mask = rows["interpolated"].to_numpy(dtype=bool)
            found[f"{scene['name']}/{agent}"] = torch.from_numpy(mask.copy())
    return found


def read_recordings(source: WindowSource) -> dict[str, str]:
    """By its name the recording that each scene is part of, or is itself.

    Raises:
        ValueError: The source is no finished converted cache.
    """
    return recordings_by_scene(converted(source).scenes())


def recorded_noise(source: WindowSource, mode: str, dt_s: float) -> RecordedNoise | None:
    """Noise of the positions of a mode, as the conversion report tells it.

    The report knows the noise σ of a recorded position from what the smoother left over and from
    the share of white noise that it takes up. The tracks have other steps than the recording: with
    σ (recorded step / dt)^½ for each of them they say as much about a path as the recording did.

    Args:
        source: A cache that scripts/convert.py wrote.
        mode: Mode of transport.
        dt_s: Step of the tracks in s.

    Returns:
        The noise, 0 where a conversion without smoother left no residual; None where the report
        has nothing of that mode.

    Raises:
        ValueError: The source is no converted cache.
    """
    cache = converted(source)
    told = _residual(cache, mode)
    if told is None:
        return None
    if "step_s" in told:
        share = math.sqrt(told["step_s"] / dt_s)
        return RecordedNoise(share * told["noise_along_m"], share * told["noise_across_m"])
    if max(told["along_m"], told["across_m"]) > 0.0:
        logger.warning(
            "The report of '%s' tells no noise, only what the smoother left over, which is less "
            "where samples are sparse. Convert again, or set `noise`.",
            cache.name,
        )
    return RecordedNoise(told["along_m"], told["across_m"])


def recorded_step(source: WindowSource, mode: str, dt_s: float) -> float:
    """Usual step in s between two samples of the recordings of a mode, as the report tells it.

    Args:
        source: A cache that scripts/convert.py wrote.
        mode: Mode of transport.
        dt_s: Step of the tracks in s, taken with a warning where the report tells none.

    Raises:
        ValueError: The source is no converted cache.
    """
    cache = converted(source)
    told = (_residual(cache, mode) or {}).get("step_s")
    if told is None:
        logger.warning(
            "The report of '%s' tells no step of the recordings of '%s': %g s is taken, that of "
            "the tracks. Convert again.",
            cache.name,
            mode,
            dt_s,
        )
    return told or dt_s


def recorded_sampling(
    source: WindowSource, names: Collection[str]
) -> dict[str, tuple[float, float]]:
    """When tracks were sampled, as the report tells it.

    Args:
        source: A cache that scripts/convert.py wrote.
        names: "recording/agent" of the tracks; of those that the report does not tell a warning
            is given.

    Returns:
        By name the time in s from the first sample to the first row, and that between two samples.

    Raises:
        ValueError: The source is no converted cache.
    """
    cache = converted(source)
    told = {
        f"{scene['name']}/{agent}": (lead_s, step_s)
        for scene in cache.report().get("scenes", ())
        for agent, (lead_s, step_s) in scene.get("sampling", {}).items()
    }
    known = {name: told[name] for name in names if name in told}
    if len(known) < len(names):
        logger.warning(
            "The report of '%s' does not tell when %d of %d tracks were sampled: equal steps from "
            "a row on are taken. Convert again.",
            *(cache.name, len(names) - len(known), len(names)),
        )
    return known


def _residual(cache: ConvertedCache, mode: str) -> dict[str, float] | None:
    """What the smoother of the positions left of the noise of a mode."""
    return cache.report().get("totals", {}).get("smoother_residual", {}).get(mode)


def _scene_tracks(cache: ConvertedCache, name: str, mode: Mode) -> dict[str, Motion]:
    scene = scene_of(cache, name)
    chosen = [agent.name for agent in scene.agents or () if int(agent.type) == mode]
    table = agent_rows(cache, name)
    return {
        f"{name}/{agent}": _motion(table[table["agent_id"] == agent], scene.dt) for agent in chosen
    }


def _motion(rows: pd.DataFrame, dt_s: float) -> Motion:
    """Motion from rows x, y, vx, vy, heading of the smoothed track."""
    columns = rows.sort_values("scene_ts")[["x", "y", "vx", "vy", "heading"]].to_numpy("float64")
    state = torch.tensor(columns)
    position, velocity, heading = state[:, :2], state[:, 2:4], state[:, 4]
    moving = velocity.norm(dim=-1) >= STANDSTILL_MPS
    return Motion(position, heading, rotate(velocity, -heading), yaw_rate(heading, moving, dt_s))
