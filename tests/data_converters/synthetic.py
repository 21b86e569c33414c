"""Small made-up recordings in the format of every data set, whose future can be replaced.

`WRITERS[name](folder, change_s)` writes the recordings of `data=name`. With `change_s` every agent
rides on differently from that time of its scene on; what was recorded before stays as it was.
"""

import gzip
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from data_converters import generate_sample, generate_vru_sample

SECONDS = 11.0
RADIUS_M = 6378137.0


class Ride(NamedTuple):
    """Position (n, 2) m, heading and yaw rate (n,) rad, rad/s, and speed (n,) m/s."""

    position: np.ndarray
    heading: np.ndarray
    yaw_rate: np.ndarray
    speed: np.ndarray


def ride(time_s, lane=0.0, change_s=None):
    """A winding ride; from `change_s` on another one."""
    fine = np.arange(0.0, time_s[-1] + 0.02, 0.01)
    changed = np.zeros_like(fine, bool) if change_s is None else fine > change_s
    yaw_rate = np.where(changed, -0.7, 0.4 * np.sin(0.8 * fine + lane))
    speed = np.where(changed, 2.0, 3.0 + 0.2 * lane + 0.5 * np.sin(0.5 * fine))
    heading = 0.2 * lane + np.cumsum(yaw_rate) * 0.01
    course = np.stack([np.cos(heading), np.sin(heading)], 1)
    path = np.cumsum(course * speed[:, None], axis=0) * 0.01 + [0.0, 3.0 * lane]
    columns = [np.interp(time_s, fine, column) for column in (*path.T, heading, yaw_rate, speed)]
    return Ride(np.stack(columns[:2], 1), *columns[2:])


def times(rate_hz, seconds=SECONDS):
    return np.arange(round(seconds * rate_hz)) / rate_hz


def zipped(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def thab_vru(root, change_s=None):
    time_s = times(12.5)
    for number in range(4):
        xy = ride(time_s, number, change_s).position
        table = pd.DataFrame({"timestamp": time_s, "x": xy[:, 0], "y": xy[:, 1]})
        path = root / "cyclists" / "moving" / f"{number}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        table.to_csv(path)


def two_wheeler(root, change_s=None):
    root.mkdir(parents=True, exist_ok=True)
    time_s = times(2.0)
    moved = ride(time_s, 1.0, change_s)
    # z and x of the sensor are east and north; the box stands upright on the ground
    turned = Rotation.from_euler("y", moved.heading[:, None]).as_quat()
    table = pd.DataFrame({"time_s": time_s, "obj_id": 0, "x": moved.position[:, 1], "y": 0.9})
    table = table.assign(z=moved.position[:, 0], sx=0.6, sy=1.8, sz=1.9)
    table[["qx", "qy", "qz", "qw"]] = turned
    table.to_csv(root / "bicycle.csv", index=False)


def eth_ucy(root, change_s=None):
    time_s = times(2.5, 16.0)
    for part, name in (("all_data", "biwi_eth"), ("train", "a_train"), ("val", "a_val")):
        rows = [
            f"{780 + 10 * step}\t{number}.0\t{x:.4f}\t{y:.4f}"
            for number in range(3)
            for step, (x, y) in enumerate(0.4 * ride(time_s, number, change_s).position)
        ]
        zipped(root / part / f"{name}.txt.gz", "\n".join(rows))


def _clips(root, rate_hz, change_s):
    """Three clips with two pedestrians and a vehicle, y down, as CITR and DUT have them."""
    time_s = times(rate_hz)
    frame = 311 + np.arange(len(time_s))
    for clip in ("crossing_01", "crossing_02", "crossing_03"):
        people = []
        for number in range(2):
            x, y = ride(time_s, number, change_s).position.T
            velocity = {"vx_est": 0.0, "vy_est": 0.0}
            rows = {"id": number, "frame": frame, "label": "ped", "x_est": x, "y_est": -y}
            people.append(pd.DataFrame(rows | velocity))
        moved = ride(time_s, 3.0, change_s)
        x, y = moved.position.T
        rows = {"id": 0, "frame": frame, "label": "veh", "x_est": x, "y_est": -y}
        rows |= {"psi_est": -moved.heading, "vel_est": moved.speed}
        zipped(root / "filtered" / f"{clip}_ped.csv.gz", pd.concat(people).to_csv(index=False))
        zipped(root / "filtered" / f"{clip}_veh.csv.gz", pd.DataFrame(rows).to_csv(index=False))


def citr(root, change_s=None):
    _clips(root, 29.97, change_s)


def dut(root, change_s=None):
    _clips(root, 23.98, change_s)


def sdd(root, change_s=None):
    time_s = times(30.0)
    for video in ("video0", "video1", "video2"):
        rows = []
        for number, label in enumerate(("Biker", "Pedestrian", "Skater")):
            for frame, (x, y) in enumerate(ride(time_s, number, change_s).position / 0.04):
                box = f"{x - 10:.3f} {-y - 10:.3f} {x + 10:.3f} {-y + 10:.3f}"
                rows.append(f'{number} {box} {frame} {int(frame >= 320)} 0 1 "{label}"')
        zipped(root / "gates" / video / "annotations.txt.gz", "\n".join(rows))
    scales = [f"gates,video{number},0.04,1.0" for number in range(3)]
    header = "scene,video,metres_per_pixel,certainty"
    (root / "scales.csv").write_text("\n".join([header, *scales]))


def autobike_log(change_s=None, seconds=20.0):
    """A log in the columns of the source: 100 Hz, a new position every tenth row."""
    time_s = times(100.0, seconds)
    moved = ride(time_s, 1.0, change_s)
    seen = moved.position[10 * (np.arange(len(time_s)) // 10)]
    zero = np.zeros_like(time_s)
    return pd.DataFrame(
        {
            "Lat GPS (deg)": 1.0065 + seen[:, 1] / RADIUS_M,
            "Long GPS (deg)": 0.2094 + seen[:, 0] / RADIUS_M / np.cos(1.0065),
            "Accelerometer Y (rad/s^2)": zero,
            "Gyroscope X (rad/s)": zero,
            "Gyroscope Z (rad/s)": moved.yaw_rate,
            "Steering Angle encoder(rad)": np.arctan(1.165 * moved.yaw_rate / moved.speed),
            "Speed VESC (rad/s)": 1.03 * moved.speed / 0.35,
            "Time (ms)": 875426 + 10 * np.arange(len(time_s)),
            "State Estimate Roll (rad)": -0.1 * moved.yaw_rate,
        }
    )


def autobike(root, change_s=None):
    for number in range(3):
        text = autobike_log(change_s).to_csv(index=False, float_format="%.12f")
        zipped(root / "recordings" / "09_06" / f"{number}.csv.gz", text + "\n" * number)


def csv(root, change_s=None):
    root.mkdir(parents=True, exist_ok=True)
    time_s = times(10.0)
    for place in range(3):
        parts = []
        for number, kind in enumerate(("e-scooter", "bike")):
            moved = ride(time_s, number, change_s)
            rows = {"time": time_s, "agent": f"a{number}", "type": kind}
            rows |= {"x": moved.position[:, 0], "y": moved.position[:, 1]}
            parts.append(pd.DataFrame(rows))
        table = pd.concat(parts)
        if place:
            table.to_csv(root / f"day_{place}.csv", index=False)
        else:
            table.to_parquet(root / "day_0.parquet", index=False)


def imptc(root, change_s=None):
    generate_sample(root, seed=3, sequences=(0,), duration_s=16.0)
    _turn_away(list(root.glob("*/*/*/track.json")), change_s)


def imptc_vru(root, change_s=None):
    generate_vru_sample(root, seed=3, sequences=(0,), duration_s=16.0)
    _turn_away(list(root.glob("*/*/track.json")), change_s)


def _turn_away(paths: list[Path], change_s) -> None:
    """Move what comes after `change_s` sideways and turn it, boxes included."""
    contents = {path: json.loads(path.read_text()) for path in paths}
    samples = [s for content in contents.values() for s in content["track_data"].values()]
    stamps = [int(sample["ts"]) for sample in samples]
    origin, unit = min(stamps), 1e-6 if min(stamps) > 1e14 else 1e-3
    for sample in samples if change_s is not None else ():
        since = (int(sample["ts"]) - origin) * unit - change_s
        if since > 0.0:
            place = np.array(sample["coordinates"])
            moved = place + [0.5 + 2.0 * since, -3.0 * since, 0.0]
            sample["coordinates"] = moved.tolist()
            if "cuboid" in sample:
                turn = Rotation.from_euler("z", 0.5 * since).as_matrix()
                corners = np.array(sample["cuboid"]) - place
                sample["cuboid"] = (corners @ turn.T + moved).tolist()
    for path, content in contents.items():
        path.write_text(json.dumps(content))


WRITERS = {
    writer.__name__: writer
    for writer in (
        autobike,
        citr,
        csv,
        dut,
        eth_ucy,
        imptc,
        imptc_vru,
        sdd,
        thab_vru,
        two_wheeler,
    )
}


TABLE_TIME_S = np.arange(0.0, 12.0, 0.1)


def table(**changes):
    """A scooter that rides east at 4 m/s, in the columns of the defaults."""
    columns = {
        "time": TABLE_TIME_S,
        "x": 4.0 * TABLE_TIME_S,
        "y": 1.0,
        "agent": 7,
        "type": "scooter",
    }
    return pd.DataFrame(columns | changes)


def first_scene(dataset, *, strict=True):
    """The first scene of a data set as it is read."""
    return dataset.read(dataset.scenes()[0], 0.1, strict=strict)
