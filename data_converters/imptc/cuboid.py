"""Size and axis of a vehicle from the 12 edges of its cuboid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from data_converters.errors import RejectReason, TrackError, fault

Array = NDArray[np.float64]


class Cuboid(NamedTuple):
    """Length, width, height in m and the direction of the longer side in rad, modulo pi."""

    length: float
    width: float
    height: float
    axis: float


def measure_cuboid(edges: object, where: str) -> Cuboid:
    """Size and axis of a cuboid given by its edges.

    The 8 unique corners are found, the 4 lowest in z form the base (the ground slopes by 4-5 %, far
    less than a vehicle is high), its convex hull has four sides: opposite ones are averaged, the
    longer pair gives length and axis.

    Args:
        edges: 12 edges of two 3-D points in m.
        where: File and sample, for the message.

    Returns:
        Size in m and axis in rad, in [0, pi).

    Raises:
        TrackError: If the edges do not form a cuboid.
    """
    corners = _corners(edges, where)
    order = np.argsort(corners[:, 2], kind="stable")
    base, top = corners[order[:4]], corners[order[4:]]
    try:
        hull = ConvexHull(base[:, :2]).vertices
    except QhullError as error:
        raise TrackError(
            _message(f"a degenerate base {base[:, :2].tolist()}", where), RejectReason.BROKEN_CUBOID
        ) from error
    if len(hull) != 4:
        raise TrackError(
            _message(f"a base with {len(hull)} corners", where), RejectReason.BROKEN_CUBOID
        )
    ring = base[hull, :2]
    sides = np.roll(ring, -1, axis=0) - ring
    first, second = (sides[0] - sides[2]) / 2.0, (sides[1] - sides[3]) / 2.0
    longer, shorter = sorted((first, second), key=lambda side: -float(np.hypot(*side)))
    return Cuboid(
        length=float(np.hypot(*longer)),
        width=float(np.hypot(*shorter)),
        height=float(top[:, 2].mean() - base[:, 2].mean()),
        axis=float(np.arctan2(longer[1], longer[0]) % np.pi),
    )


def _corners(edges: object, where: str) -> Array:
    try:
        points = np.asarray(edges, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TrackError(_message("no numbers", where), RejectReason.BROKEN_CUBOID) from error
    if points.shape != (12, 2, 3) or not np.isfinite(points).all():
        raise TrackError(_message(f"shape {points.shape}", where), RejectReason.BROKEN_CUBOID)
    corners = np.unique(np.round(points.reshape(-1, 3), 3), axis=0)
    if len(corners) != 8:
        raise TrackError(_message(f"{len(corners)} corners", where), RejectReason.BROKEN_CUBOID)
    return corners


def _message(found: str, where: str) -> str:
    requirement = "be 12 edges of two 3-D points that meet in 8 corners"
    return fault("cuboid", requirement, found, where, "Unpack the archive again.")
