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
from data_converters.multi_agent import MultiAgentDataset, Recording
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
PART = re.compile(r"(.+)_(train|val)")


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
            ConversionError: If a part is missing.
        """
        test = set(HELD_OUT[self.held_out])
        found = [Recording(n, (p,), "test") for n, p in self._files("all_data") if n in test]
        for part in ("train", "val"):
            for name, path in self._files(part):
                cut = PART.fullmatch(name)
                if cut is not None and cut[1] not in test:
                    found.append(Recording(name, (path,), part, cut[1]))
        parts = {recording.split for recording in found}
        absent = sorted({"train", "val", "test"} - parts)
        remedy = "Give the folder with all_data, train and val."
        whole = not found or not absent
        require(whole, "root", f"hold {self.expects}", f"nothing for {absent}", self.root, remedy)
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
            agent=[f"ped_{number:g}" for number in numbers["id"]],
            mode=float(Mode.PEDESTRIAN),
            time_s=numbers["frame"] / FRAMES_PER_SECOND,
        )

    def _files(self, part: str) -> list[tuple[str, Path]]:
        """Names without endings and paths of the files of a folder."""
        paths = [*(self.root / part).glob("*.txt"), *(self.root / part).glob("*.txt.gz")]
        return sorted((path.name.partition(".")[0], path) for path in paths)
