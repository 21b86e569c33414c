"""Which column of a table holds what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import pandas as pd

from data_converters.errors import require

REQUIRED = ("time", "x", "y")
NAMES = ("agent", "type", "scene", "recording")
"""Columns that hold names; all others hold numbers."""


@dataclass(frozen=True)
class TableColumns:
    """Names of the columns; None where a table has no such column.

    Attributes:
        time: Time of a sample.
        x: Position to the east.
        y: Position to the north.
        agent: Name or number of the agent; None: every file or scene is one agent.
        type: Type of the agent, which is mapped to a mode; None: all are of the mode given.
        scene: Agents of one scene share a clock and are neighbors; None: every file is a scene.
        recording: Scenes of one recording stay in one split; None: every scene is a recording.
        heading: Direction the agent faces.
        speed: Speed as recorded; only compared with the smoothed one.
        length: Length of the agent.
        width: Width of the agent.
        controls: By name of a control or sensor the column that holds it, in SI units.

    Raises:
        ConversionError: If time, x or y has no column.
    """

    time: str = "time"
    x: str = "x"
    y: str = "y"
    agent: str | None = "agent"
    type: str | None = "type"
    scene: str | None = None
    recording: str | None = None
    heading: str | None = None
    speed: str | None = None
    length: str | None = None
    width: str | None = None
    controls: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "controls", dict(self.controls))
        for name in REQUIRED:
            value = getattr(self, name)
            require(bool(value), f"columns.{name}", "name a column", value, "", "Name it.")

    def settings(self) -> dict[str, object]:
        """All names as plain values."""
        return asdict(self)

    def named(self) -> dict[str, str]:
        """By what it holds the column of the table, without controls."""
        return {name: column for name, column in asdict(self).items() if isinstance(column, str)}

    def numbers(self) -> list[str]:
        """The columns of the table that hold numbers."""
        named = [column for name, column in self.named().items() if name not in NAMES]
        return [*named, *self.controls.values()]

    def require_all(self, table: pd.DataFrame, where: object) -> None:
        """Refuse a table that lacks a column.

        Raises:
            ConversionError: The message names the setting, the column, and those that are there.
        """
        wanted = self.named() | {f"controls.{k}": column for k, column in self.controls.items()}
        for name, column in wanted.items():
            found = f"'{column}', while the table has {', '.join(map(str, table.columns))}"
            remedy = f"Set data.columns.{name}=NAME" + ("." if name in REQUIRED else ", or =null.")
            if name.startswith("controls."):
                remedy = f"Give +data.columns.{name}=NAME, or leave it out."
            needs = "name a column of the table"
            present = column in table.columns
            require(present, f"columns.{name}", needs, Plain(found), where, remedy)


class Plain(str):
    """Text that a message shows as it is."""

    def __repr__(self) -> str:
        return str(self)
