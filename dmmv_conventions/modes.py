"""Modes of transport: how agents travel, in caches, batches, configurations and tables."""

from enum import IntEnum

from dmmv_conventions.checks import require_one_of


class Mode(IntEnum):
    """Mode of transport of an agent.

    The first five values are those of trajdata's `AgentType`, whose `VEHICLE` is a car; the rest
    continue it, because trajdata knows no scooter. Members equal, and hash like, their integer, so
    they work in trajdata's filters, distance tables and batches.
    """

    UNKNOWN = 0
    CAR = 1
    PEDESTRIAN = 2
    BICYCLE = 3
    MOTORCYCLE = 4
    SCOOTER = 5
    SKATEBOARD = 6
    CART = 7
    STROLLER = 8
    WHEELCHAIR = 9
    TRUCK = 10

    @classmethod
    def named(cls, name: str, argument: str = "mode") -> "Mode":
        """Return the mode of that name, in any case of letters.

        Args:
            name: Its name.
            argument: Where the name was given.

        Raises:
            ValueError: There is no such mode.
        """
        labels = sorted(mode.label for mode in cls)
        require_one_of(argument, name.lower(), labels)
        return cls[name.upper()]

    @property
    def label(self) -> str:
        """The name in lower case, as configurations, reports and tables write it."""
        return self.name.lower()
