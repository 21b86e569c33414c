"""Whether there is any place left among discs, which rejection sampling alone never knows."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

COARSEST_M = 0.25
FINEST_M = 5e-4
"""Sides of the squares that are looked through; what is left of the finest may hold a place."""
ROUNDING_M = 1e-9
QUARTERS = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])

Region = Callable[[Float[np.ndarray, "k 2"], float], Bool[np.ndarray, " k"]]
"""Which squares, by their centres and half of their side in m, meet where places can be drawn."""


class Taken(NamedTuple):
    """Discs within which nobody else can be placed."""

    center: Float[np.ndarray, "n 2"]  # m
    radius: Float[np.ndarray, " n"]  # m

    def room(self, places: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, " k"]:
        """Distance in m of places to the nearest disc, negative within one."""
        x, y = np.moveaxis(self.center - places[:, None], -1, 0)
        return (np.sqrt(x * x + y * y) - self.radius).min(-1)

    def and_of(self, other: "Taken") -> "Taken":
        """These discs and others."""
        return Taken(*(np.concatenate(both) for both in zip(self, other, strict=True)))


def may_have_place(region: Region, taken: Taken, extent_m: float) -> bool:
    """Whether a region may have a place outside of all discs; where the answer is no, it has none.

    Squares that a single disc covers or that no place lies in are left out, the others quartered,
    until a centre is a place or no square is left.

    Args:
        region: Where places can be drawn; a square of side zero is a point.
        taken: Where none is free.
        extent_m: Half the side of a square about the origin that holds the region.
    """
    count = int(np.ceil(extent_m / COARSEST_M))
    line = (np.arange(-count, count) + 0.5) * COARSEST_M
    centers, half = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2), COARSEST_M / 2
    while True:
        centers = centers[region(centers, half)]
        room = taken.room(centers)
        if region(centers[room >= 0], 0.0).any():
            return True
        centers = centers[room + np.sqrt(2) * half >= -ROUNDING_M]
        if not len(centers) or 2 * half <= FINEST_M:
            return len(centers) > 0
        half /= 2
        centers = (centers[:, None] + half * QUARTERS).reshape(-1, 2)
