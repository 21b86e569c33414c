"""Modes of travel as they stand in the cache, and sizes for agents that nobody measured."""

from __future__ import annotations

from enum import IntEnum

from trajdata.data_structures.agent import FixedExtent


class Mode(IntEnum):
    """Agent type stored in the cache.

    The first five values are trajdata's `AgentType`; the rest continue it, because trajdata knows
    no scooter. Members equal, and hash like, their integer, so they work in trajdata's filters,
    distance tables and batches. `VEHICLE` is a car.
    """

    UNKNOWN = 0
    VEHICLE = 1
    PEDESTRIAN = 2
    BICYCLE = 3
    MOTORCYCLE = 4
    SCOOTER = 5
    SKATEBOARD = 6
    CART = 7
    STROLLER = 8
    WHEELCHAIR = 9
    TRUCK = 10


_DEFAULT_EXTENT_M = {
    Mode.UNKNOWN: (0.8, 0.8, 1.6),
    Mode.VEHICLE: (4.5, 1.8, 1.5),
    Mode.PEDESTRIAN: (0.5, 0.6, 1.75),
    Mode.BICYCLE: (1.8, 0.6, 1.75),
    Mode.MOTORCYCLE: (2.1, 0.8, 1.6),
    Mode.SCOOTER: (1.2, 0.6, 1.85),
    Mode.SKATEBOARD: (0.8, 0.6, 1.8),
    Mode.CART: (2.4, 1.2, 1.9),
    Mode.STROLLER: (1.6, 0.6, 1.75),
    Mode.WHEELCHAIR: (1.1, 0.7, 1.35),
    Mode.TRUCK: (9.0, 2.5, 3.2),
}


def default_extent(mode: Mode) -> FixedExtent:
    """Size assumed for a mode, (length, width, height) in m, rider or pusher included.

    Only vehicles of the IMPTC sequences carry a measured size (their cuboid); every other agent
    gets this one. Values are typical outer dimensions, not measurements of the data sets.
    """
    return FixedExtent(*_DEFAULT_EXTENT_M[mode])
