"""Evaluated runs: where each stands in a table, and what it told in the end."""

from pathlib import Path
from typing import Any, NamedTuple

from diffstack_mmv.reporting.files import read_json


class Run(NamedTuple):
    """One evaluated run and its place in the table."""

    data: str
    mode: str
    model: str
    goal: str
    seed: int
    report: Path

    @property
    def metrics(self) -> Path:
        """The file that tells how it was judged."""
        return self.report / "metrics.json"

    @property
    def ended(self) -> bool:
        """Whether it was judged."""
        return self.metrics.is_file()

    @property
    def place(self) -> tuple[str, str, str]:
        """Data set, mode and goal, which the models have in common."""
        return self.data, self.mode, self.goal

    def read(self) -> dict[str, Any]:
        """What it told.

        Raises:
            ValueError: It has not ended.
        """
        return read_json(self.metrics)
