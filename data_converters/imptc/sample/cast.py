"""Who travels in a sample sequence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data_converters.imptc.sample.routes import make_route
from data_converters.imptc.sample.traffic import Traveller


class Kind(NamedTuple):
    """A kind of road user: class, number per sequence, speeds (m/s), size (m), place (m)."""

    class_id: int
    count: int
    speed_mps: tuple[float, float]
    acceleration_mps2: float
    extent_m: tuple[float, float, float]
    offset_m: float
    reach_m: float
    box_m: float
    both_sides: bool = False


PEDESTRIAN = Kind(0, 4, (1.0, 1.6), 0.8, (0.5, 0.6, 1.75), 8.5, 24.0, 11.0, True)
BICYCLE = Kind(2, 3, (3.4, 5.2), 1.0, (1.8, 0.6, 1.75), 4.4, 46.0, 10.0)
MOTORCYCLE = Kind(3, 2, (6.0, 8.0), 1.6, (2.1, 0.8, 1.6), 1.9, 75.0, 12.0)
SCOOTER = Kind(4, 2, (3.4, 5.0), 1.2, (1.2, 0.6, 1.85), 4.8, 46.0, 10.0)
STROLLER = Kind(5, 1, (0.9, 1.3), 0.6, (1.6, 0.6, 1.75), 9.0, 22.0, 11.0, True)
WHEELCHAIR = Kind(6, 1, (0.8, 1.4), 0.6, (1.1, 0.7, 1.35), 8.8, 22.0, 11.0, True)
CAR = Kind(7, 2, (7.0, 10.0), 1.6, (4.5, 1.8, 1.5), 1.9, 75.0, 12.0)
TRUCK = Kind(8, 1, (6.0, 8.0), 1.0, (8.5, 2.4, 3.1), 1.9, 75.0, 14.0)
UNKNOWN = Kind(10, 1, (1.0, 1.6), 0.8, (0.6, 0.6, 1.6), 8.2, 24.0, 11.0, True)

ALWAYS = (BICYCLE, SCOOTER, MOTORCYCLE, PEDESTRIAN, CAR)
IN_TURNS = (STROLLER, WHEELCHAIR, TRUCK, UNKNOWN)
"""One of these joins the others; STROLLER and WHEELCHAIR also alternate in every sequence."""


def make_cast(number: int, duration_s: float, rng: np.random.Generator) -> list[Traveller]:
    """Road users of sequence `number` of `duration_s` s, in random order of right of way."""
    kinds = [kind for kind in ALWAYS for _ in range(kind.count)]
    kinds.append(IN_TURNS[number % 2])
    if number % 4 >= 2:
        kinds.append(IN_TURNS[number % 4])
    order = rng.permutation(len(kinds))
    return [_traveller(kinds[i], duration_s, rng) for i in order]


def _traveller(kind: Kind, duration_s: float, rng: np.random.Generator) -> Traveller:
    entry = int(rng.integers(4))
    leave = (entry + int(rng.choice([1, 2, 2, 3]))) % 4
    side = -1.0 if kind.both_sides and rng.random() < 0.5 else 1.0
    offset = side * (kind.offset_m + rng.normal(0.0, 0.15))
    route = make_route(entry, leave, offset, kind.reach_m, kind.box_m)
    speed = float(rng.uniform(*kind.speed_mps))
    size = 1.0 + 0.04 * rng.standard_normal(3)
    length, width, height = (float(a * b) for a, b in zip(kind.extent_m, size, strict=True))
    return Traveller(
        class_id=kind.class_id,
        route=route,
        speed_mps=speed,
        acceleration_mps2=kind.acceleration_mps2,
        extent_m=(length, width, height),
        start_s=float(rng.uniform(0.0, max(duration_s - 15.0, 0.0))),
        start_m=float(rng.uniform(0.0, 0.25 * route.stop_m)),
        wander=(
            float(rng.uniform(0.05, 0.2)),
            float(rng.uniform(5.0, 9.0)),
            float(rng.uniform(0, 6.28)),
        ),
    )
