"""Scenes that the page can play, from the records of evaluations and drives.

A scene has one entry per time in `times`: bodies (a path of x, y, heading in m and rad, null where
unknown, and a shape in m), ellipses (x, y, and the covariance xx, xy, yy in m², with a weight) and
lines of that time; lines that stay; and series of numbers below the picture.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffstack_mmv.reporting.html.blocks import plain
from diffstack_mmv.reporting.html.quantities import quantity

Array = NDArray[Any]
FAINT = 0.1  # weight of an ellipse among many
GAP_M = 3.0  # between two scenes side by side
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
    radius_m: float  # of a pedestrian, where the episodes do not tell
    goal_m: tuple[float, float] | None  # as well
    footprint: Mapping[str, Any]  # as `actual_model` of closed_loop.json tells it
    controls: Sequence[str]  # their names


def driven_scene(
    title: str, arrays: Mapping[str, Array], row: int, around: Surroundings
) -> dict[str, Any]:
    """An episode: robot, agents, what the controller expected and planned, clearance, controls.

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
    agents = arrays["pedestrians"][row, :end]
    radii = np.full(agents.shape[1], around.radius_m)
    radii = arrays["scene.radius"][row] if "scene.radius" in arrays else radii
    goal = arrays["scene.goal"][row] if "scene.goal" in arrays else around.goal_m
    bodies = [{"name": "robot", "role": "robot", "path": plain(robot, 3), "shape": _shape(around)}]
    for number in np.flatnonzero(np.isfinite(agents).any((0, 2))):
        path = np.concatenate([agents[:, number], np.full((end, 1), np.nan)], 1)
        walked = {"name": f"pedestrian {number + 1}", "role": "agent", "path": plain(path, 3)}
        bodies.append(walked | {"shape": {"radius": float(radii[number])}})
    series = [{"name": "clearance [m]", "values": plain(arrays["clearance"][row, :end], 3)}]
    speed = np.linalg.norm(arrays["motion.velocity"][row, :end], axis=-1)
    series.append({"name": "speed [m/s]", "values": plain(speed, 3)})
    for column, values in enumerate(arrays["controls"][row, :steps].T):
        named = around.controls[column] if column < len(around.controls) else f"control {column}"
        series.append({"name": quantity(named), "values": [*plain(values, 3), None]})
    return {
        "title": title,
        "times": plain(around.dt_s * np.arange(end)),
        "start": 0,
        "goal": None if goal is None else plain(np.asarray(goal), 3),
        "bodies": bodies,
        "lines": [{"role": "robot", "points": plain(place, 3)}],
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
    proposed = arrays.get("thoughts.candidates")
    if proposed is not None and step < proposed.shape[1]:
        paths = (path for path in proposed[row, step] if np.isfinite(path).all())
        told["lines"] += [{"role": "candidate", "points": plain(path, 2)} for path in paths]
    if forecasts is not None and step < forecasts.shape[1]:
        # every third time is enough to see where somebody goes
        expected = forecasts[row, step, :, 2::3].reshape(-1, 5)
        known = expected[np.isfinite(expected).all(1)]
        told["ellipses"] = [[*each, FAINT] for each in plain(known, 3)]
    return told


def side_by_side(title: str, left: Mapping[str, Any], right: Mapping[str, Any]) -> dict[str, Any]:
    """Two driven scenes in one picture under one slider, the second one laid to the right.

    Args:
        title: What the list shows.
        left: A scene of `driven_scene`.
        right: Another one of the same step; the shorter one waits at its end.
    """
    longer = max(left, right, key=lambda scene: len(scene["times"]))
    shift = GAP_M + _reach(left, max) - _reach(right, min)
    both = [_waiting(left, len(longer["times"]), 0.0), _waiting(right, len(longer["times"]), shift)]
    frames = [
        {key: [*one[key], *other[key]] for key in ("ellipses", "lines")}
        for one, other in zip(both[0]["frames"], both[1]["frames"], strict=True)
    ]
    return {
        "title": title,
        "times": longer["times"],
        "start": 0,
        "goal": None,
        "goals": [scene["goal"] for scene in both if scene["goal"]],
        "bodies": [body for scene in both for body in scene["bodies"]],
        "lines": [line for scene in both for line in scene["lines"]],
        "frames": frames,
        "series": [
            {"name": f"{side} {series['name']}", "values": series["values"]}
            for side, scene in zip(("left:", "right:"), both, strict=True)
            for series in scene["series"]
        ],
    }


def _reach(scene: Mapping[str, Any], extreme: Callable[..., float]) -> float:
    """Where everybody of a scene is at most or at least, along x in m."""
    return extreme(place[0] for body in scene["bodies"] for place in body["path"] if place)


def _waiting(scene: Mapping[str, Any], steps: int, shift: float) -> dict[str, Any]:
    """A scene of so many steps, laid to the right by `shift` m."""
    more = steps - len(scene["times"])

    def moved(points: Sequence[Any]) -> list[Any]:
        return [point and [point[0] + shift, *point[1:]] for point in points]

    def line(told: Mapping[str, Any]) -> dict[str, Any]:
        return {**told, "points": moved(told["points"])}

    frames = [*scene["frames"], *[{"ellipses": [], "lines": []}] * more]
    return {
        "goal": moved([scene["goal"]])[0] if scene["goal"] else None,
        "bodies": [
            {**body, "path": moved([*body["path"], *[body["path"][-1]] * more])}
            for body in scene["bodies"]
        ],
        "lines": [line(each) for each in scene["lines"]],
        "frames": [
            {"ellipses": moved(each["ellipses"]), "lines": [line(told) for told in each["lines"]]}
            for each in frames
        ],
        "series": [
            {**each, "values": [*each["values"], *[None] * more]} for each in scene["series"]
        ],
    }
