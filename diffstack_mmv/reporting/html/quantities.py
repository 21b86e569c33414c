"""Titles of the entries of states and controls, with their units."""

UNITS = {
    "time_s": "s",
    "position": "m",
    "velocity": "m/s",
    "speed": "m/s",
    "acceleration": "m/s²",
    "heading": "rad",
    "yaw_rate": "rad/s",
    "lean": "rad",
    "lean_rate": "rad/s",
    "steer": "rad",
}
"""Name of an entry, or what it begins with -> its unit."""
OF_AN_AXIS = ("_x", "_y", "_forward", "_left", "_s")


def quantity(name: str) -> str:
    """What people call an entry: `position_x` is "position x [m]".

    Args:
        name: Name of the entry; one that is unknown stays without a unit.
    """
    of = next((name.removesuffix(end) for end in OF_AN_AXIS if name.endswith(end)), name)
    unit = UNITS.get(name, UNITS.get(of))
    plain = (of if name.endswith("_s") else name).replace("_", " ")
    return plain if unit is None else f"{plain} [{unit}]"
