"""The problems of the comparison by name."""

from peers import driving, unicycle

PROBLEMS = {
    "obstacle": driving.OBSTACLE,
    "free": driving.FREE,
    "unicycle": unicycle.BOXED,
    "unicycle-free": unicycle.FREE,
}
