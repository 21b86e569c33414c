"""Where recordings come from: a cache that our converters wrote, or a data set of trajdata's."""

import fnmatch
import hashlib
import json
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from trajdata.augmentation.augmentation import DatasetAugmentation
from trajdata.utils import env_utils

from diffstack_mmv.checks import message, require
from diffstack_mmv.data.corrections import HeldHeading, UpwardY
from diffstack_mmv.data.damage import only_file
from diffstack_mmv.data.registration import TrajdataWindows
from diffstack_mmv.data.settings import WindowSettings
from dmmv_conventions.cache import (
    REPORT_FILE,
    STATE_FILE,
    conversion_of,
    read_state,
    recordings_by_scene,
    require_own,
)
from dmmv_conventions.opening import CachedEnvironment

logger = logging.getLogger(__name__)

_USUAL_CORRECTIONS: dict[str, tuple[DatasetAugmentation, ...]] = {"sdd": (UpwardY(), HeldHeading())}


@runtime_checkable
class WindowSource(Protocol):
    """A data set with splits, from which windows can be read."""

    @property
    def name(self) -> str:
        """Name of the data set."""
        ...

    def identity(self) -> dict[str, object]:
        """Plain values that change whenever the recordings or their conversion do."""
        ...

    def smoother(self) -> str:
        """How the tracks were smoothed, and how far it looked ahead."""
        ...

    def open(self, split: str, windows: WindowSettings) -> TrajdataWindows:
        """Open the windows of one split."""
        ...


@dataclass(frozen=True)
class ConvertedCache:
    """A data set in a cache that `scripts/convert.py` wrote.

    Attributes:
        name: Name of the data set, e.g. "thab_vru".
        folder: Folder of the cache.
        sequences: Scenes to use, by name or pattern such as "09_06_*"; None takes all.
    """

    name: str
    folder: str
    sequences: Sequence[str] | None = None

    def identity(self) -> dict[str, object]:
        """Name and a hash of the state and the report of the conversion.

        Raises:
            ValueError: The cache is absent, unfinished or of another version.
        """
        self._state()
        digest = hashlib.sha256()
        for file in (STATE_FILE, REPORT_FILE):
            path = self._path / file
            digest.update(path.read_bytes() if path.is_file() else b"")
        chosen = {} if self.sequences is None else {"sequences": sorted(self.sequences)}
        return {"dataset": self.name, "content": digest.hexdigest(), **chosen}

    def smoother(self) -> str:
        """Name and look-ahead in s of the smoother, as the cache tells them.

        Raises:
            ValueError: The cache is absent, unfinished or of another version.
        """
        used = self.smoother_settings()
        return f"{used['name']}, looks {used['lookahead_s']:g} s ahead"

    def smoother_settings(self) -> dict[str, Any]:
        """Name, fields and look-ahead in s of the smoother.

        Raises:
            ValueError: The cache is absent, unfinished or of another version.
        """
        settings: dict[str, Any] = self._state()["smoother"]
        return settings

    def scenes(self) -> list[dict[str, Any]]:
        """Name, split, steps and agents per mode of every scene.

        Raises:
            ValueError: The cache is absent, unfinished or of another version.
        """
        return self._chosen(self._state())["scenes"]

    def dt_s(self) -> float:
        """Step of the tracks in s.

        Raises:
            ValueError: The cache is absent, unfinished or of another version.
        """
        return float(self._state()["dt_s"])

    def report(self) -> dict[str, Any]:
        """The report of the conversion, empty if there is none."""
        path = self._path / REPORT_FILE
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}

    def open(self, split: str, windows: WindowSettings) -> TrajdataWindows:
        """Open the windows of one split.

        Raises:
            ValueError: The cache is absent, unfinished or of another version, has no such split or
                another step, or holds no window.
        """
        state = self._chosen(self._state())
        splits = sorted({scene["split"] for scene in state["scenes"]})
        require(
            split in splits,
            "split",
            f"be one of {', '.join(splits)}",
            f"'{split}'",
            f"for '{self.name}'",
        )
        _require_step(windows, state["dt_s"], f"in {self._path / STATE_FILE}")
        for scene in state["scenes"]:
            path = only_file(self._path / scene["name"], "scene_metadata_dt*.dill")
            needs, remedy = (
                "hold the files of its conversion",
                conversion_of(self.name, Path(self.folder)),
            )
            require(path.is_file(), "cache", needs, "no such file", f"at {path}", remedy)
        cache = Path(self.folder)
        return TrajdataWindows(
            f"{self.name}-{split}",
            windows,
            cache,
            [CachedEnvironment(cache, state)],
            recordings=recordings_by_scene(state["scenes"]),
        )

    def _chosen(self, state: dict[str, Any]) -> dict[str, Any]:
        """The state with the chosen scenes alone.

        Raises:
            ValueError: No scene has one of the names.
        """
        if self.sequences is None:
            return state
        names = [scene["name"] for scene in state["scenes"]]
        absent = [wanted for wanted in self.sequences if not fnmatch.filter(names, wanted)]
        some = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        where = f"for '{self.name}'"
        require(not absent, "sequences", f"name scenes such as {some}", absent, where)
        kept = {name for wanted in self.sequences for name in fnmatch.filter(names, wanted)}
        return {**state, "scenes": [s for s in state["scenes"] if s["name"] in kept]}

    @property
    def _path(self) -> Path:
        return Path(self.folder) / self.name

    def _state(self) -> dict[str, Any]:
        return read_state(Path(self.folder), self.name)


@dataclass(frozen=True)
class NamedDataset:
    """A data set that trajdata itself reads, by its name there.

    Attributes:
        name: trajdata's name, e.g. "sdd" or "eupeds_eth".
        root: Folder of the recordings in the layout that trajdata documents.
        folder: Folder of the cache that trajdata writes.
        corrections: Repairs of each scene. By default the heading is held at standstill, and the y
            axis is turned up where the recordings are in picture coordinates ("sdd").
        sequences: None; trajdata tells no scene of these data sets by its name.

    Raises:
        ValueError: `sequences` is given.
    """

    name: str
    root: str
    folder: str
    corrections: Sequence[DatasetAugmentation] | None = None
    sequences: Sequence[str] | None = None

    def __post_init__(self) -> None:
        needs, remedy = "be null for data that trajdata reads itself", "Convert the data set."
        require(self.sequences is None, "sequences", needs, self.sequences, "", remedy)
        if self.corrections is None:
            usual = _USUAL_CORRECTIONS.get(self.name, (HeldHeading(),))
            object.__setattr__(self, "corrections", usual)

    def smoother(self) -> str:
        """None of ours: trajdata takes the tracks as they are."""
        return "none, tracks as trajdata reads them"

    def identity(self) -> dict[str, object]:
        """Name, folder of the recordings, version of trajdata and the repairs.

        trajdata does not tell when recordings change under an existing cache.
        """
        repairs = [[type(repair).__name__, vars(repair)] for repair in self.corrections or ()]
        root = str(Path(self.root).expanduser().resolve())
        return {
            "dataset": self.name,
            "root": root,
            "trajdata": version("trajdata"),
            "corrections": repairs,
        }

    def open(self, split: str, windows: WindowSettings) -> TrajdataWindows:
        """Open the windows of one split; the first time trajdata reads all recordings.

        Raises:
            ValueError: trajdata does not know the data set or the split, the folder is missing, the
                step does not fit, or there is no window.
        """
        root = Path(self.root).expanduser()
        require(
            root.is_dir(), "root", "be a folder with recordings", root, "", "Give data.root=FOLDER."
        )
        try:
            environment = env_utils.get_raw_dataset(self.name, str(root))
        except ValueError as error:
            raise ValueError(message("name", "be known to trajdata", f"'{self.name}'")) from error
        tags = [str(tag) for tag in environment.scene_tags]
        asked = {self.name, *split.split("-")}
        known = bool(environment.get_matching_scene_tags(asked))
        require(
            known, "split", f"be part of a tag of '{self.name}' ({', '.join(tags)})", f"'{split}'"
        )
        _require_resampling(windows, environment.metadata.dt, f"for '{self.name}'")
        query = f"{self.name}-{split}"
        folders = {self.name: str(root)}
        cache = Path(self.folder).expanduser()
        require_own(cache / self.name, "Give another data.cache=FOLDER")
        return TrajdataWindows(query, windows, cache, (), folders, self.corrections or ())


def _require_step(windows: WindowSettings, recorded_s: float, where: str) -> None:
    """Refuse a step that leaves out no whole number of rows: between rows the next one is known."""
    factor = windows.dt_s / recorded_s
    require(
        round(factor) >= 1 and math.isclose(factor, round(factor), rel_tol=1e-6),
        "dt_s",
        f"be a multiple of {recorded_s:g}",
        windows.dt_s,
        where,
        "Convert the data with the step you want.",
    )


def _require_resampling(windows: WindowSettings, recorded_s: float, where: str) -> None:
    """As `_require_step`, for data that cannot be converted anew: whole fractions are told."""
    parts = recorded_s / windows.dt_s
    if round(parts) < 2 or not math.isclose(parts, round(parts), rel_tol=1e-6):
        _require_step(windows, recorded_s, where)
        return
    logger.warning(
        "dt_s=%g %s: rows are recorded every %g s, and those between are interpolated, so that "
        "inputs look ahead by up to %g s. Take dt_s=%g for a result that does not.",
        *(windows.dt_s, where, recorded_s, recorded_s, recorded_s),
    )
