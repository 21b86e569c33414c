"""Scenes of a table: the rows that belong to each of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from data_converters.errors import ConversionError
from data_converters.tables.columns import NAMES, TableColumns
from data_converters.tables.reading import names_of, read_table

UNNAMED = ""
"""What stands for the scene of rows that name none."""


@dataclass(frozen=True)
class SceneTables:
    """Tables of files, and their parts; what was read last is kept, since scenes come in order.

    Attributes:
        columns: Which column holds what.
    """

    columns: TableColumns
    _latest: dict[Path, pd.DataFrame] = field(default_factory=dict, init=False, repr=False)
    _parts: dict[Path, dict[str, pd.DataFrame]] = field(
        default_factory=dict, init=False, repr=False
    )

    def rows(self, path: Path) -> pd.DataFrame:
        """The table of a file, with the columns that are named.

        Raises:
            TrackError: The file is no table.
        """
        if path not in self._latest:
            self._latest.clear()
            named = self.columns.named()
            names = {named[each] for each in NAMES if each in named}
            self._latest[path] = read_table(path, names, self.columns.numbers())
        return self._latest[path]

    def scenes(self, path: Path) -> Mapping[str | None, str]:
        """Scenes of a file, None for the file itself, and the recording of each."""
        scene, recording = self.columns.scene, self.columns.recording
        if scene is None and recording is None:
            return {None: ""}
        try:
            rows = self.rows(path)
            self.columns.require_all(rows, path)
        except ConversionError:
            # it is refused, and counted, when it is read
            return {None: ""}
        groups = pd.Series("", index=rows.index)
        if recording:
            groups = names_of(rows[recording]).fillna("")
        if scene is None:
            return {None: str(groups.iloc[0]) if len(groups) else ""}
        pairs = pd.DataFrame({"scene": self._names(rows), "group": groups})
        return {str(s): str(g) for s, g in pairs.drop_duplicates("scene").itertuples(index=False)}

    def of_scene(self, path: Path, scene: str | None) -> pd.DataFrame:
        """Rows of a scene of a file, which are grouped once for all; all of them for None.

        Raises:
            TrackError: The file is no table.
        """
        rows = self.rows(path)
        if scene is None:
            return rows
        if path not in self._parts:
            self._parts.clear()
            parts = rows.groupby(self._names(rows))
            self._parts[path] = {str(name): part for name, part in parts}
        return self._parts[path][scene]

    def _names(self, rows: pd.DataFrame) -> pd.Series:
        """Names of the scenes of rows; some column holds them."""
        return names_of(rows[self.columns.scene]).fillna(UNNAMED)
