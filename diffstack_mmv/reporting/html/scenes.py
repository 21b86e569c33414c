"""Scenes that the page can play, from the records of evaluations and drives.

A scene has one entry per time in `times`: bodies (a path of x, y, heading in m and rad, null where
unknown, and a shape in m), ellipses (x, y, and the covariance xx, xy, yy in m², with a weight) and
lines of that time; lines that stay; and series of numbers below the picture.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffstack_mmv.reporting.html.blocks import plain

Array = NDArray[Any]
FAINT = 0.1  # weight of an ellipse among many
DISC_M = 0.3  # radius of a robot whose outline nobody told


def planned_scene(record: Mapping[str, Any]) -> dict[str, Any]:
    """A scene of an evaluation: past and future of everybody, prediction, candidates and plan.

    Args:
        record: One entry of `scenes.json`.
    """
    ego, plan, dt_s = record["ego"], record["plan"], record["dt_s"]
    before, after = len(ego["past"]), len(ego["future"])
    unknown: list[None] = [None] * (before - 1)
    bodies = [
        _body("human", "human", ego["past"] + ego["future"], ego["extent"]),
        _body("plan", "plan", unknown + plan, ego["extent"]),
    ]
    for number, other in enumerate(record["neighbors"]):
        name = f"{other['mode']} {number + 1}"
        bodies.append(_body(name, "agent", other["past"] + other["future"], other["extent"]))
    forecasts = [record["prediction"], *(other["prediction"] for other in record["neighbors"])]
    ahead = [_ellipses(forecasts, step) for step in range(after)]
    lines = [{"role": "candidate", "points": path} for path in record["candidates"]]
    lines += [
        {"role": "prediction", "points": path, "weight": weight}
        for path, weight in zip(
            record["prediction"]["mean"], record["prediction"]["weight"], strict=True
        )
    ]
    for role, path in (("human", ego["past"] + ego["future"]), ("plan", plan)):
        lines.append({"role": role, "points": [point[:2] for point in path if point]})
    times = dt_s * np.arange(1 - before, after + 1)
    return {
        "title": record["title"],
        "times": plain(times),
        "start": before - 1,
        "goal": record["goal"],
        "bodies": bodies,
        "lines": lines,
        "frames": [{"ellipses": [], "lines": []}] * before
        + [{"ellipses": each, "lines": []} for each in ahead],
        "series": [],
    }


def _body(name: str, role: str, path: Sequence[Any], extent: Sequence[float]) -> dict[str, Any]:
    shape = {"length": extent[0], "width": extent[1]}
    return {"name": name, "role": role, "path": list(path), "shape": shape}


def _ellipses(forecasts: Sequence[Mapping[str, Any]], step: int) -> list[list[float]]:
    """Where everybody is expected at a step: x, y, xx, xy, yy, weight."""
    return [
        [*mean[step], *covariance[step], weight]
        for told in forecasts
        for mean, covariance, weight in zip(
            told["mean"], told["covariance"], told["weight"], strict=True
        )
        if mean[step][0] is not None
    ]


class Surroundings(NamedTuple):
    """What all episodes of a drive share."""

    dt_s: float
    radius_m: float  # of a pedestrian
    goal_m: tuple[float, float] | None
    footprint: Mapping[str, Any]  # as `actual_model` of closed_loop.json tells it
    controls: Sequence[str]  # their names


def driven_scene(
    title: str, arrays: Mapping[str, Array], row: int, around: Surroundings
) -> dict[str, Any]:
    """An episode: robot, people, what the controller expected and planned, clearance, controls.

    Args:
        title: What the list shows.
        arrays: Content of a file of episodes.
        row: Number of the episode in it.
        around: What the file does not hold.
    """
    steps = int(arrays["steps"][row])
    end = steps + 1
    place, heading = arrays["motion.position"][row, :end], arrays["motion.heading"][row, :end]
    robot = np.concatenate([place, heading[:, None]], 1)
    people = arrays["pedestrians"][row, :end]
    bodies = [{"name": "robot", "role": "plan", "path": plain(robot, 3), "shape": _shape(around)}]
    for number in np.flatnonzero(np.isfinite(people).any((0, 2))):
        path = np.concatenate([people[:, number], np.full((end, 1), np.nan)], 1)
        walked = {"name": f"pedestrian {number + 1}", "role": "agent", "path": plain(path, 3)}
        bodies.append(walked | {"shape": {"radius": around.radius_m}})
    series = [{"name": "clearance [m]", "values": plain(arrays["clearance"][row, :end], 3)}]
    speed = np.linalg.norm(arrays["motion.velocity"][row, :end], axis=-1)
    series.append({"name": "speed [m/s]", "values": plain(speed, 3)})
    for column, values in enumerate(arrays["controls"][row, :steps].T):
        named = around.controls[column] if column < len(around.controls) else f"control {column}"
        series.append({"name": named, "values": [*plain(values, 3), None]})
    return {
        "title": title,
        "times": plain(around.dt_s * np.arange(end)),
        "start": 0,
        "goal": list(around.goal_m) if around.goal_m else None,
        "bodies": bodies,
        "lines": [{"role": "plan", "points": plain(place, 3)}],
        "frames": [_thought(arrays, row, step) for step in range(end)],
        "series": series,
    }


def _shape(around: Surroundings) -> dict[str, float]:
    told = around.footprint
    if {"length_m", "width_m"} <= told.keys():
        return {"length": told["length_m"], "width": told["width_m"]}
    return {"radius": told.get("radius_m", DISC_M)}


def _thought(arrays: Mapping[str, Array], row: int, step: int) -> dict[str, Any]:
    """What the controller expected and planned at a step, where the file tells it."""
    told: dict[str, Any] = {"ellipses": [], "lines": []}
    plans, forecasts = arrays.get("thoughts.plan"), arrays.get("thoughts.forecast")
    if plans is not None and step < plans.shape[1] and np.isfinite(plans[row, step]).all():
        told["lines"].append({"role": "intent", "points": plain(plans[row, step], 2)})
    if forecasts is not None and step < forecasts.shape[1]:
        # every third time is enough to see where somebody goes
        expected = forecasts[row, step, :, 2::3].reshape(-1, 5)
        known = expected[np.isfinite(expected).all(1)]
        told["ellipses"] = [[*each, FAINT] for each in plain(known, 3)]
    return told
