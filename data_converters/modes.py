"""Sizes of agents that nobody measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

# earlier caches name the modes as `data_converters.modes.Mode`
from dmmv_conventions.modes import Mode

if TYPE_CHECKING:
    from trajdata.data_structures.agent import FixedExtent

_DEFAULT_EXTENT_M = {
    Mode.UNKNOWN: (0.8, 0.8, 1.6),
    Mode.CAR: (4.5, 1.8, 1.5),
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


def usual_size(mode: Mode) -> tuple[float, float, float]:
    """Size assumed for a mode, (length, width, height) in m, rider or pusher included."""
    return _DEFAULT_EXTENT_M[mode]


def default_extent(mode: Mode) -> FixedExtent:
    """The size assumed for a mode, in m, as trajdata has it.

    Only vehicles of the IMPTC sequences carry a measured size (their cuboid); every other agent
    gets this one. Values are typical outer dimensions, not measurements of the data sets.
    """
    from trajdata.data_structures.agent import FixedExtent

    return FixedExtent(*usual_size(mode))
