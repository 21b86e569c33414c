"""Tables of your own as scenes: every file, or every scene that a column names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from data_converters.errors import (
    ConversionError,
    RejectReason,
    TrackError,
    refuse_track,
    require,
)
from data_converters.multi_agent import MultiAgentDataset, Recording, modes_of
from data_converters.recordings import RawScene
from data_converters.tables.agreement import require_agreement
from data_converters.tables.columns import TableColumns
from data_converters.tables.numbers import require_numbers, with_faults
from data_converters.tables.outputs import recorded
from data_converters.tables.reading import names_of
from data_converters.tables.scenes import UNNAMED, SceneTables
from data_converters.tables.units import Plausibility, TableUnits
from dmmv_conventions.cache import CONTROLS_TABLE, SPLITS
from dmmv_conventions.checks import did_you_mean
from dmmv_conventions.modes import Mode

ENDINGS = ("csv", "csv.gz", "parquet")
ENDING = re.compile(r"\.(csv|csv\.gz|parquet)$")
OWN_NAMES = {mode.label: mode.label for mode in Mode}


@dataclass(frozen=True)
class TableDataset(MultiAgentDataset):
    """CSV and Parquet tables, one row per agent and time.

    Attributes:
        root: Folder; all .csv, .csv.gz and .parquet files in it and below it are read,
            but for what commands wrote there: caches, folders of runs, hidden folders.
        split: How whole recordings are dealt to the splits.
        called: Name of the data set in the cache; letters, digits and "_".
        columns: Which column holds what.
        units: Their units.
        plausible: Rate and speed that are believed.
        types: Mode by type, as the column of the type has it; case does not count.
        mode: Mode of all agents of tables without a type.

    Raises:
        ConversionError: If the name, a mode or a column cannot be used.
    """

    location: ClassVar[str] = "own_tables"
    expects: ClassVar[str] = "tables (.csv, .csv.gz or .parquet)"

    called: str = "csv"
    columns: TableColumns = field(default_factory=TableColumns)
    units: TableUnits = field(default_factory=TableUnits)
    plausible: Plausibility = field(default_factory=Plausibility)
    types: Mapping[str, str] = field(default_factory=lambda: OWN_NAMES)
    mode: str | None = None

    def __post_init__(self) -> None:
        needs, remedy = "consist of letters, digits and _", "Give data.name=NAME."
        fits = re.fullmatch(r"\w+", self.called, re.ASCII) is not None
        require(fits, "name", needs, self.called, "", remedy)
        given = {} if self.mode is None else {"mode": self.mode}
        for place, label in {
            **{f"types.{k}": each for k, each in self.types.items()},
            **given,
        }.items():
            known, needs = str(label).lower() in OWN_NAMES, f"be one of {', '.join(OWN_NAMES)}"
            meant = did_you_mean(str(label), OWN_NAMES)
            require(known, place, needs, label, "", meant or "Choose one.")
        needs, remedy = "be given where the tables have no type", "Set data.mode or a column."
        typed = self.columns.type is not None or self.mode is not None
        require(typed, "mode", needs, self.mode, "", remedy)

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The name in the cache."""
        return self.called

    @property
    def unit_of_positions(self) -> str:
        """The unit, with its setting."""
        return f"{self.units.length} (data.units.length)"

    def settings(self) -> Mapping[str, object]:
        """All that changes what is read."""
        return {
            **super().settings(),
            "columns": self.columns.settings(),
            "units": self.units.settings(),
            "plausible": asdict(self.plausible),
            "types": dict(self.types),
            "mode": self.mode,
        }

    def recordings(self) -> list[Recording]:
        """One per file, or one per scene of each file.

        Raises:
            ConversionError: If the first table lacks a column.
        """
        found: dict[str, Recording] = {}
        self._scene_of.clear()
        for path in self._paths:
            stem = _plain(ENDING.sub("", str(path.relative_to(self.root))))
            for scene, group in self._tables.scenes(path).items():
                name = stem if scene is None else f"{stem}_{_plain(scene) or 'unnamed'}"
                while name in found:
                    name += "_"
                self._scene_of[name] = scene
                # what is only counted takes no part in the deal
                counted = scene == UNNAMED or path in self._repeated
                dealt = not counted or (group or name) in self.split.given
                found[name] = Recording(name, (path,), None if dealt else SPLITS[0], group)
        return list(found.values())

    def table(self, path: Path, recording: Recording, raw: RawScene) -> pd.DataFrame:
        """Samples of one scene in SI units.

        Raises:
            TrackError: If the file is no table, or the rows have no scene.
            ConversionError: If it lacks a column, or its units cannot be right.
        """
        if self._repeats(path, raw):
            return pd.DataFrame()
        columns = self.columns
        with self._unlike_others(recording):
            columns.require_all(self._tables.rows(path), path)
            rows = self._of_recording(recording)
            if self._scene_of.get(recording.name) == UNNAMED:
                needs, found, remedy = (
                    "have a name",
                    f"none in {len(rows)} rows",
                    "Name it in each.",
                )
                refuse_track(RejectReason.NO_SCENE, "scene", needs, found, path, remedy)
            table = self._checked(rows, path)
        if columns.controls:
            numbers = {name: self.units.numbers(rows[c]) for name, c in columns.controls.items()}
            controls = table[["agent", "time_s"]].rename(columns={"agent": "agent_id"})
            raw.side_tables[CONTROLS_TABLE] = controls.assign(**numbers)
            for name, values in numbers.items():
                raw.note(f"rows_without_{name}", int(values.isna().sum()))
        return table

    def _checked(self, rows: pd.DataFrame, path: Path) -> pd.DataFrame:
        """Samples in SI units that can be right.

        Raises:
            ConversionError: A unit must be wrong.
        """
        require_numbers(rows, self.columns, self.units, path)
        table = with_faults(self._in_si(rows), rows, self.columns, self.units, path)
        self.plausible.check(table, path)
        table = table.assign(**self._modes(rows), **self._measured(rows))
        require_agreement(table, self.columns, self.units, path)
        return table

    def _in_si(self, rows: pd.DataFrame) -> pd.DataFrame:
        columns, units = self.columns, self.units
        return pd.DataFrame(
            {
                "agent": "agent" if columns.agent is None else names_of(rows[columns.agent]),
                "time_s": units.seconds(rows[columns.time]),
                **units.places(rows[columns.x], rows[columns.y]),
            }
        )

    @contextmanager
    def _unlike_others(self, recording: Recording) -> Iterator[None]:
        """Refuse one recording that the settings do not describe, if they describe another.

        Raises:
            TrackError: They do, so that it is this one that is wrong.
            ConversionError: They describe none, so that they are wrong.
        """
        try:
            yield
        except TrackError:
            raise
        except ConversionError as error:
            others = (each for each in self._index.values() if each.name != recording.name)
            if any(self._fits(other) for other in others):
                raise TrackError(str(error), RejectReason.OTHER_TABLE) from error
            raise

    def _fits(self, recording: Recording) -> bool:
        """Whether the settings describe a recording."""
        (path,) = recording.files
        try:
            self.columns.require_all(self._tables.rows(path), path)
            table = self._checked(self._of_recording(recording), path)
        except ConversionError:
            return False
        return len(table) > 0

    def _of_recording(self, recording: Recording) -> pd.DataFrame:
        """Rows of a recording among those of its file."""
        (path,) = recording.files
        return self._tables.of_scene(path, self._scene_of.get(recording.name))

    def _modes(self, rows: pd.DataFrame) -> dict[str, Any]:
        if self.columns.type is None:
            return {"mode": float(Mode.named(str(self.mode)))}
        known = {str(kind): Mode.named(str(label)) for kind, label in self.types.items()}
        labels = names_of(rows[self.columns.type])
        modes = modes_of(labels, known)
        unknown = {label: self._advice(label) for label in labels[modes.isna()].unique()}
        return {"mode": modes, "label": labels, "advice": labels.map(unknown)}

    def _advice(self, label: object) -> str:
        """What to do about a type without a mode; NaN stands for none."""
        column = f"column '{self.columns.type}'"
        if not isinstance(label, str):
            return f"Fill in {column} in every row."
        meant = did_you_mean(label, map(str, self.types))
        setting = f"+data.types.{label}=MODE" if re.fullmatch(r"[\w-]+", label) else "`types`"
        return f"{meant} Correct {column}, or add the type: {setting}.".lstrip()

    def _measured(self, rows: pd.DataFrame) -> dict[str, pd.Series]:
        """Optional columns in SI units."""
        turned = {
            "heading": self.units.radians,
            "speed": self.units.metres_per_second,
            "length": self.units.metres,
            "width": self.units.metres,
        }
        named = self.columns.named()
        return {name: turn(rows[named[name]]) for name, turn in turned.items() if name in named}

    @cached_property
    def _paths(self) -> list[Path]:
        found = (path for ending in ENDINGS for path in self.root.rglob(f"*.{ending}"))
        return recorded(found, self.root)

    def _read_files(self) -> list[Path]:
        return self._paths

    @cached_property
    def _tables(self) -> SceneTables:
        return SceneTables(self.columns)

    @cached_property
    def _scene_of(self) -> dict[str, str | None]:
        return {}


def _plain(name: str) -> str:
    """A name that can be one of a folder and of a scene."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", name)
