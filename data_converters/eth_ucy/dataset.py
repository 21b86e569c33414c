"""ETH and UCY: a scene is held out, the published cuts of the other recordings train and choose."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

from data_converters.csv_table import told_as_fault
from data_converters.errors import RejectReason, refuse_track, require
from data_converters.multi_agent import MultiAgentDataset, Recording, agent_names, by_name
from data_converters.recordings import RawScene
from dmmv_conventions.modes import Mode

HELD_OUT = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""Recordings of each scene; all others, crowds_zara03 and uni_examples included, train."""

FRAMES_PER_SECOND = 25.0
"""Ten frame numbers are one step of 0.4 s."""

COLUMNS = ("frame", "id", "x", "y")
ENDING = re.compile(r"(_train|_val)?\.txt(\.gz)?$")


@dataclass(frozen=True)
class EthUcyDataset(MultiAgentDataset):
    """The splits of Trajectron++: whole recordings of the scene held out are the test.

    The environment carries the scene in its name, so that the five of them fit into one cache.

    Attributes:
        root: Folder with all_data, train and val.
        held_out: Scene of the test: eth, hotel, univ, zara1 or zara2.

    Raises:
        ConversionError: If there is no such scene.
    """

    location: ClassVar[str] = "zurich_and_nicosia"
    expects: ClassVar[str] = "all_data/, train/ and val/ with .txt or .txt.gz files"

    held_out: str = "eth"

    def __post_init__(self) -> None:
        known = self.held_out in HELD_OUT
        require(known, "held_out", f"be one of {', '.join(HELD_OUT)}", self.held_out)

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The data set and the scene held out."""
        return f"eth_ucy_{self.held_out}"

    def settings(self) -> Mapping[str, object]:
        """The scene held out."""
        return {"held_out": self.held_out}

    def recordings(self) -> list[Recording]:
        """The test scene as a whole, and the cuts of all other recordings.

        Raises:
            ConversionError: If a part, or a recording of the test scene, is missing.
        """
        test, whole = HELD_OUT[self.held_out], self._files("all_data")
        found = [Recording(name, (whole[name],), "test") for name in test if name in whole]
        absent = [name for name in test if name not in whole]
        for part in ("train", "val"):
            cuts = [(name, path) for name, path in self._files(part).items() if name not in test]
            found += [Recording(f"{name}_{part}", (path,), part, name) for name, path in cuts]
            absent += [] if cuts else [part]
        remedy = "Give the folder with all_data, train and val."
        complete, missing = not found or not absent, f"nothing for {absent}"
        require(complete, "root", f"hold {self.expects}", missing, self.root, remedy)
        return found

    def table(self, path: Path, recording: Recording, raw: RawScene) -> pd.DataFrame:
        """Pedestrians of one file; the world coordinates are those of the source.

        Raises:
            TrackError: If it is no table of four columns of numbers.
        """
        with told_as_fault(path):
            rows = pd.read_csv(path, sep=r"\s+", header=None, dtype=str)
        if len(rows.columns) != len(COLUMNS):
            needs, remedy = f"have the columns {', '.join(COLUMNS)}", "Copy the file again."
            found = f"{len(rows.columns)} columns"
            refuse_track(RejectReason.MISSING_FIELD, "file", needs, found, path, remedy)
        numbers = rows.apply(pd.to_numeric, errors="coerce").astype(np.float64)
        numbers.columns = pd.Index(COLUMNS)
        return numbers.assign(
            agent=agent_names("ped", numbers["id"]),
            mode=float(Mode.PEDESTRIAN),
            time_s=numbers["frame"] / FRAMES_PER_SECOND,
        )

    def _files(self, part: str) -> dict[str, Path]:
        """Files of a folder by their names without endings."""
        paths = [*(self.root / part).glob("*.txt"), *(self.root / part).glob("*.txt.gz")]
        return by_name(sorted((ENDING.sub("", path.name), path) for path in paths))
