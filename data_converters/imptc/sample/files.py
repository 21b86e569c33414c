"""Writing of sample recordings in the file formats of IMPTC, with their variations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_converters.imptc.modes import CLASS_NAMES
from data_converters.imptc.sample.lights import SIGNAL_ARMS, SignalPlan
from data_converters.imptc.sample.sensor import Detections, cuboid_edges


class Spelling:
    """How a sequence spells its files; real sequences differ in the same ways.

    Odd sequences write timestamps as text and `lenght`; every third one calls the samples ts_0, ...
    """

    def __init__(self, number: int) -> None:
        self.text_timestamps = number % 2 == 1
        self.length_key = "lenght" if number % 2 == 1 else "length"
        self.key = "ts_{}" if number % 3 == 0 else "{}"
        self.first = 0 if number % 3 == 0 else 1

    def timestamp(self, value: int) -> int | str:
        """A timestamp in microseconds as it stands in the file."""
        return str(value) if self.text_timestamps else value


def write_json(path: Path, content: Any) -> None:
    """Write compact JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, separators=(",", ":")), encoding="utf-8")


def track_content(
    class_id: int,
    clock_us: NDArray[np.int64],
    seen: Detections,
    extent_m: tuple[float, float, float] | None,
    spelling: Spelling,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Content of a track.json.

    Args:
        class_id: IMPTC class.
        clock_us: (n,) timestamps of the samples in microseconds.
        seen: n samples in m, rad and m/s.
        extent_m: Size of the cuboid of a vehicle, None for a VRU.
        spelling: Variation of the format.
        rng: Source of noise.

    Returns:
        Plain values.
    """
    samples = {}
    for row, ts in enumerate(clock_us.tolist()):
        sample: dict[str, Any] = {"ts": spelling.timestamp(ts)}
        position = seen.position[row]
        if extent_m is None:
            probability = round(float(rng.uniform(0.85, 1.0)), 2)
            sample |= {"status": 2 if row > 5 else 1, "class_prob": probability}
        else:
            edges = cuboid_edges(position, float(seen.heading[row]), extent_m)
            sample["cuboid"] = np.round(edges + rng.normal(0, 0.01, (1, 1, 3)), 2).tolist()
        sample["coordinates"] = np.round(position, 2).tolist()
        sample["velocity"] = round(float(seen.speed[row]) * 3.6, 1)
        sample |= {"ground_type": 0, "z_offset": round(float(position[2]), 2)}
        samples[spelling.key.format(row + spelling.first)] = sample
    overview = {
        "first_ts": spelling.timestamp(int(clock_us[0])),
        "last_ts": spelling.timestamp(int(clock_us[-1])),
        spelling.length_key: len(clock_us),
        "duration": int(clock_us[-1] - clock_us[0]) // 1000,
        "class_id": class_id,
        "class_name": CLASS_NAMES[class_id],
    }
    return {"overview": overview, "track_data": samples}


def write_context(
    folder: Path,
    clock_us: NDArray[np.int64],
    plan: SignalPlan,
    spelling: Spelling,
    rng: np.random.Generator,
) -> None:
    """Write master clock (n,) in microseconds, lights at 1 Hz and weather every 10 s."""
    seconds = (clock_us - clock_us[0]) / 1e6
    lights, weather = {}, {}
    for number, row in enumerate(range(0, len(clock_us), 25)):
        states = {
            name: int(plan.state(np.array([arm]), seconds[row])[0])
            for name, arm in SIGNAL_ARMS.items()
        }
        lights[f"ts_{number}"] = {"ts": spelling.timestamp(int(clock_us[row])), **states}
    for number, row in enumerate(range(0, len(clock_us), 250)):
        weather[f"ts_{number}"] = {
            "ts": spelling.timestamp(int(clock_us[row])),
            "air_pressure": round(float(rng.normal(1008.0, 4.0)), 1),
            "air_temperature": round(float(rng.normal(14.0, 5.0)), 1),
            "relative_humidity": round(float(rng.uniform(40.0, 90.0)), 1),
            "wind_speed": round(float(rng.uniform(0.0, 6.0)), 1),
            "wind_direction": round(float(rng.uniform(0.0, 360.0)), 1),
            "precipitation_intensity": 0.0,
            "precipitation_amount": 0.0,
            "visibility": 2000.0,
            "weather_nws": 0,
        }
    overview = {"first_ts": int(clock_us[0]), "last_ts": int(clock_us[-1])}
    state = {"overview": {**overview, "status": 0, "name": "sunny_cloudy"}, "weather_data": weather}
    write_json(folder / "weather_data.json", state)
    state = {"overview": overview, "status_data": lights}
    write_json(folder / "traffic_light_signals.json", state)
    master = {
        str(ts): {"id": i, "weather_data": i % 250 == 0, "traffic_lights_data": i % 25 == 0}
        for i, ts in enumerate(clock_us.tolist())
    }
    write_json(folder / "master_timestamp_sync.json", master)
