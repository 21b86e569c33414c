"""Class ids of IMPTC and the modes of the cache."""

from __future__ import annotations

from dmmv_conventions.modes import Mode

CLASS_MODES = {
    0: Mode.PEDESTRIAN,
    2: Mode.BICYCLE,
    3: Mode.MOTORCYCLE,
    4: Mode.SCOOTER,
    5: Mode.STROLLER,
    6: Mode.WHEELCHAIR,
    7: Mode.CAR,
    8: Mode.TRUCK,
    10: Mode.UNKNOWN,
}
"""By class id; class names differ between the files and the documents of the data set."""

CLASS_NAMES = {
    0: "Pedestrian",
    2: "Bicycle",
    3: "Motorcycle",
    4: "Scooter",
    5: "Stroller",
    6: "Wheelchair",
    7: "Car",
    8: "Truck/Bus",
    10: "Unknown",
}
"""Names of the documents; only the sample writes them."""

VEHICLE_CLASSES = frozenset({7, 8})
"""Classes whose tracks carry a cuboid and stand in the folder `vehicles`."""
