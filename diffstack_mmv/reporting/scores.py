"""What a table has to know of a score."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable


@runtime_checkable
class ScoreHeading(Protocol):
    """Names, unit and direction of a score, as a registry holds them."""

    @property
    def name(self) -> str:
        """Key in files."""
        ...

    @property
    def title(self) -> str:
        """For people, without the unit."""
        ...

    @property
    def unit(self) -> str:
        """Unit, "1" for a dimensionless number or a share."""
        ...

    @property
    def lower_is_better(self) -> bool:
        """Direction."""
        ...

    @property
    def heading(self) -> str:
        """Title and unit as a table's column has them."""
        ...


Scores = Mapping[str, ScoreHeading]
"""Scores by name."""
