"""Paths through a four-way intersection with right-hand traffic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_converters.heading import direction

Array = NDArray[np.float64]

SPACING_M = 0.1
LATERAL_LIMIT_MPS2 = 1.6
BRAKE_MPS2 = 1.2


@dataclass(frozen=True)
class Route:
    """A path sampled every 0.1 m.

    Attributes:
        points: (n, 2) m.
        heading: (n,) rad, continuous.
        speed_limit: (n,) m/s that the curvature allows, braking in time.
        stop_m: Arc length of the stop line in m.
        arm: Arm of entry: 0 east, 1 north, 2 west, 3 south.
    """

    points: Array
    heading: Array
    speed_limit: Array
    stop_m: float
    arm: int

    @property
    def length_m(self) -> float:
        """Length in m."""
        return SPACING_M * (len(self.points) - 1)


def _arm(number: int) -> Array:
    directions = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    return directions[number % 4]


def _right(direction: Array) -> Array:
    return np.array([direction[1], -direction[0]])


def make_route(entry: int, leave: int, offset_m: float, reach_m: float, box_m: float) -> Route:
    """Path from one arm to another.

    Args:
        entry: Arm it comes from.
        leave: Arm it leaves by.
        offset_m: Distance to the right of the middle of the road; negative on the left pavement.
        reach_m: Distance from the centre where it starts and ends.
        box_m: Distance from the centre where the turn starts and ends; the stop line is there.

    Returns:
        The route, a straight line, a cubic curve through the box, a straight line.
    """
    outward, away = _arm(entry), _arm(leave)
    start_side, end_side = _right(-outward) * offset_m, _right(away) * offset_m
    first, last = outward * box_m + start_side, away * box_m + end_side
    pull = 0.55 * np.linalg.norm(last - first)
    u = np.linspace(0.0, 1.0, 101)[:, None]
    curve = (
        (1 - u) ** 3 * first
        + 3 * (1 - u) ** 2 * u * (first - outward * pull)
        + 3 * (1 - u) * u**2 * (last - away * pull)
        + u**3 * last
    )
    corners = np.vstack([outward * reach_m + start_side, curve, away * reach_m + end_side])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.arange(0.0, arc[-1], SPACING_M)
    points = np.column_stack([np.interp(at, arc, corners[:, i]) for i in range(2)])
    tangent = np.gradient(points, SPACING_M, axis=0)
    heading = np.unwrap(direction(tangent))
    return Route(points, heading, _speed_limit(heading), reach_m - box_m, entry)


def _speed_limit(heading: Array) -> Array:
    kernel = np.ones(21) / 21.0
    curvature = np.abs(np.convolve(np.gradient(heading, SPACING_M), kernel, mode="same"))
    limit = np.sqrt(LATERAL_LIMIT_MPS2 / np.maximum(curvature, 1e-3))
    for index in range(len(limit) - 2, -1, -1):
        braked = np.sqrt(limit[index + 1] ** 2 + 2.0 * BRAKE_MPS2 * SPACING_M)
        limit[index] = min(limit[index], braked)
    return limit
