"""Sizes and axes of a vehicle from the 12 edges of its cuboids."""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from data_converters.errors import RejectReason, refuse_track
from data_converters.heading import direction

Array = NDArray[np.float64]

TOLERANCE_M = 0.1
"""How far a corner may lie from the rectangle that the others form."""


FARTHEST_M = 1e7
"""Larger than any coordinate, in whatever frame."""


class Cuboids(NamedTuple):
    """Per sample (n,): length, width, height in m; axis of the longer side in rad, in [0, pi)."""

    length: Array
    width: Array
    height: Array
    axis: Array


def measure_cuboids(edges: list[object], where: str) -> Cuboids:
    """Sizes and axes of cuboids given by their edges.

    Every corner ends three edges, so that the 12 lowest of the 24 end points are the base (the
    ground slopes by 4-5 %, far less than a vehicle is high). The convex hull of a base is a
    rectangle of length L and width W; the second moments of its corners are (L/2)² along the longer
    side and (W/2)² along the shorter one, which gives both and the axis for all samples at once.

    Args:
        edges: n cuboids of 12 edges of two 3-D points in m.
        where: The file, for the message.

    Returns:
        Sizes in m and axes in rad.

    Raises:
        TrackError: If the edges of a sample do not form a cuboid.
    """
    points = _end_points(edges, where)
    order = np.argsort(points[..., 2], axis=1, kind="stable")[..., None]
    points = np.take_along_axis(points, order, axis=1)
    base, top = points[:, :12], points[:, 12:]
    corners = base[..., :2] - base[..., :2].mean(axis=1, keepdims=True)
    moments, axes = np.linalg.eigh(np.einsum("npi,npj->nij", corners, corners) / 12.0)
    width, length = 2.0 * np.sqrt(np.maximum(moments, 0.0)).T
    height = top[..., 2].mean(axis=1) - base[..., 2].mean(axis=1)
    half_diagonal = 0.5 * np.hypot(length, width)
    astray = np.abs(np.linalg.norm(corners, axis=-1) - half_diagonal[:, None]).max(axis=1)
    wrong = (astray > TOLERANCE_M) | (width < TOLERANCE_M) | (height < TOLERANCE_M)
    if wrong.any():
        _refuse(f"edges {np.round(points[wrong][0], 2).tolist()}", where)
    return Cuboids(length, width, height, direction(axes[:, :, 1]) % np.pi)


def _end_points(edges: list[object], where: str) -> Array:
    try:
        points = np.asarray(edges, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        _refuse("no list of numbers", where)
    if points.shape[1:] != (12, 2, 3) or not (np.abs(points) < FARTHEST_M).all():
        _refuse(f"shape {points.shape[1:]} or no possible numbers", where)
    return points.reshape(-1, 24, 3)


def _refuse(found: str, where: str) -> NoReturn:
    requirement = "be 12 edges of two 3-D points that meet in 8 corners"
    remedy = "Unpack the archive again."
    refuse_track(RejectReason.BROKEN_CUBOID, "cuboid", requirement, found, where, remedy)
