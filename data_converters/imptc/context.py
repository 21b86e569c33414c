"""Traffic lights and weather of a sequence: what trajdata has a place for, and side tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from data_converters.errors import RejectReason, TrackError, refuse_track
from data_converters.imptc.reader import load_json, microseconds

SIGNAL_GROUPS = ("k1", "k2", "k3", "k4", "k5", "k6", "f1", "f2", "f3")
"""k1-k6 are lanes of vehicles, f1-f3 crossings of pedestrians."""

STATES = {
    2: "UNKNOWN",
    4: "GREEN",
    10: "RED",
    11: "NO_DATA",
    20: "UNKNOWN",
    30: "RED",
}
"""Names of trajdata's status: yellow-blinking, green, red, disabled, yellow, red-yellow."""

LIGHTS_FILE = "traffic_light_signals.json"
WEATHER_FILE = "weather_data.json"


def read_table(path: Path, section: str, origin_us: int) -> pd.DataFrame | None:
    """One row per entry of a context file, ordered by time, those of one time as in the file.

    The time is the inner `ts` where there is one, else the key (the documents show both).

    Args:
        path: The file; it may be absent.
        section: Key of the entries.
        origin_us: Time 0 of the scene in microseconds.

    Returns:
        Column `time_s` in s and the recorded values; None if the file is absent or empty.

    Raises:
        TrackError: If the file is broken, the entries or one of them are no object, or one has no
            time.
    """
    if not path.is_file():
        return None
    content = load_json(path)
    entries = content.get(section) if isinstance(content, dict) and content else content
    if entries == {}:
        return None
    if not isinstance(entries, dict):
        needs, remedy = "be an object", "Unpack the archive again."
        refuse_track(RejectReason.MISSING_FIELD, section, needs, entries, path, remedy)
    rows = [_row(key, entry, origin_us, path) for key, entry in entries.items()]
    table = pd.DataFrame(rows).sort_values("time_s", kind="stable", ignore_index=True)
    return table.assign(**{str(name): _one_kind(table[name]) for name in table if name != "time_s"})


def _one_kind(values: pd.Series) -> pd.Series:
    """Values as they are, or their texts: a file may mix kinds, a column may not."""
    texts = all(value is None or isinstance(value, str) for value in values)
    return values if values.dtype != object or texts else values.map(str)


def _row(key: str, entry: Any, origin_us: int, path: Path) -> dict[str, Any]:
    if not isinstance(entry, dict):
        needs, remedy = "be an object", "Unpack the archive again."
        refuse_track(RejectReason.MISSING_FIELD, key, needs, entry, path, remedy)
    stamp = entry.get("ts", key.removeprefix("ts_").removeprefix("ts:"))
    time_s = (microseconds(stamp, str(path)) - origin_us) / 1e6
    values = {name: value for name, value in entry.items() if name not in ("ts", "time_s")}
    return {"time_s": time_s, **values}


def read_context(folder: Path, origin_us: int) -> tuple[dict[str, pd.DataFrame], int]:
    """Side tables of a sequence and the number of context files that could not be read.

    Args:
        folder: Folder `context`; it may be absent.
        origin_us: Time 0 of the scene in microseconds.

    Returns:
        Tables `traffic_lights` and `weather`, as far as present, with `time_s` in s; broken files.
    """
    tables: dict[str, pd.DataFrame] = {}
    broken = 0
    files = {
        "traffic_lights": (LIGHTS_FILE, "status_data"),
        "weather": (WEATHER_FILE, "weather_data"),
    }
    for stem, (name, section) in files.items():
        try:
            table = read_table(folder / name, section, origin_us)
        except TrackError:
            broken += 1
            continue
        if table is not None:
            tables[stem] = table
    return tables, broken


def signals_per_step(lights: pd.DataFrame, steps: int, dt_s: float) -> pd.DataFrame | None:
    """Traffic lights as trajdata keeps them: the latest state at every step of dt_s s.

    Args:
        lights: Column `time_s` and a column of state codes per signal group.
        steps: Number of steps.
        dt_s: Step in s.

    Returns:
        Index lane_id (the signal group) and scene_ts, column status; None where no group is known.
    """
    from trajdata.maps.traffic_light_status import TrafficLightStatus

    latest = (
        np.searchsorted(lights["time_s"].to_numpy(), np.arange(steps) * dt_s + 1e-6, side="right")
        - 1
    )
    parts = []
    for group in SIGNAL_GROUPS:
        if group not in lights:
            continue
        codes = lights[group].to_numpy()[np.maximum(latest, 0)]
        status = [TrafficLightStatus[_status(code)].value for code in codes]
        status = np.where(latest < 0, TrafficLightStatus.NO_DATA.value, status)
        parts.append(
            pd.DataFrame({"lane_id": group, "scene_ts": np.arange(steps), "status": status})
        )
    if not parts:
        return None
    return pd.concat(parts, ignore_index=True).set_index(["lane_id", "scene_ts"])


def _status(code: object) -> str:
    """Name of the status of a recorded code; unknown for anything that is no number."""
    try:
        return STATES.get(int(float(str(code))), "UNKNOWN")
    except (ValueError, OverflowError):
        return "UNKNOWN"
