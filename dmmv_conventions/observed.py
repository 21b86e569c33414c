"""What is known of agents up to now: what a live source of tracks hands to a trained stack."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ObservedAgents(NamedTuple):
    """Agents in one world, sampled at a fixed step; the first is the ego, the last row is now.

    Rows in which an agent was not observed are NaN. Axes: x east, y north, angles counter-clockwise
    from x.
    """

    names: tuple[str, ...]  # n
    modes: tuple[str, ...]  # n, such as bicycle
    extent: Array  # n 2, length and width in m
    position: Array  # n H 2, m
    velocity: Array  # n H 2, m/s, in the world
    heading: Array  # n H, rad
    dt_s: float
