"""CITR and DUT: clips seen by a drone, pedestrians and vehicles on one clock."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import pandas as pd

from data_converters.csv_table import read_by_name, read_numbers
from data_converters.errors import RejectReason, refuse_track
from data_converters.multi_agent import (
    METRES_PER_PIXEL,
    MultiAgentDataset,
    Recording,
    agent_names,
    by_name,
)
from data_converters.recordings import RawScene
from data_converters.splits import RecordingSplit
from dmmv_conventions.modes import Mode

COLUMNS = {
    (True, "ped"): ("x_est", "y_est"),
    (True, "veh"): ("x_est", "y_est", "psi_est", "vel_est"),
    (False, "ped"): ("x", "y"),
    (False, "veh"): ("x_c", "y_c"),
}
"""Columns of a file, by whether it passed the Kalman filter of the source, and by its family."""

NAMES = {
    "x_est": "x",
    "y_est": "y",
    "x_c": "x",
    "y_c": "y",
    "psi_est": "heading",
    "vel_est": "speed",
}


@dataclass(frozen=True)
class VehicleCrowdDataset(MultiAgentDataset):
    """Clips of the vehicle-crowd interaction data sets.

    The picture has y down: y and headings change their sign, so that left turns stay left. The
    filtered tracks come from a causal extended Kalman filter of the source; heading and speed of
    vehicles are its output, not measurements.

    Attributes:
        root: Folder with filtered/ and raw/.
        split: How whole clips are dealt to the splits.
        unfiltered: Whether tracks before the Kalman filter are taken where there are some.
    """

    frames_per_second: ClassVar[float]
    vehicle: ClassVar[Mode]
    raw_ending: ClassVar[Mapping[str, str]]
    """Ending of the raw file of each family, `ped` and `veh`."""

    unfiltered: bool = False

    def settings(self) -> Mapping[str, object]:
        """Split, and which tracks."""
        return {**super().settings(), "unfiltered": self.unfiltered}

    def recordings(self) -> list[Recording]:
        """One recording per clip.

        Raises:
            ConversionError: Two files of one kind have the name of one clip.
        """
        clips: dict[str, dict[str, Path]] = {}
        for filtered in (True, False) if self.unfiltered else (False, True):
            # what is found later takes the place of what was found before
            folder = self.root / ("filtered" if filtered else "raw")
            for family, ending in self._endings(filtered).items():
                paths = [*folder.glob(f"*{ending}.csv"), *folder.glob(f"*{ending}.csv.gz")]
                stems = (path.name.partition(".")[0].removesuffix(ending) for path in paths)
                for clip, path in by_name(zip(map(_plain, stems), paths, strict=True)).items():
                    clips.setdefault(clip, {})[family] = path
        return [
            Recording(clip, tuple(clips[clip][f] for f in sorted(clips[clip])))
            for clip in sorted(clips)
        ]

    def table(self, path: Path, recording: Recording, raw: RawScene) -> pd.DataFrame:
        """Agents of one file, y up.

        Raises:
            TrackError: If it is no table or lacks a column.
        """
        filtered = path.parent.name == "filtered"
        family = next(f for f, end in self._endings(filtered).items() if f"{end}." in path.name)
        table = read_numbers(path, ["frame", "id", *COLUMNS[filtered, family]], path)
        table = table.rename(columns=NAMES)
        if not filtered:
            table[["x", "y"]] *= self.metres_per_unit(recording.name)
        if "heading" in table:
            table["heading"] = -table["heading"]
            table["speed"] = table["speed"].abs()
        mode = Mode.PEDESTRIAN if family == "ped" else self.vehicle
        return table.assign(
            agent=agent_names(family, table["id"]),
            mode=float(mode),
            time_s=table["frame"] / self.frames_per_second,
            y=-table["y"],
        )

    @abstractmethod
    def metres_per_unit(self, clip: str) -> float:
        """Length in m of the unit of the raw positions of a clip.

        Raises:
            TrackError: If it is not known.
        """

    def _endings(self, filtered: bool) -> Mapping[str, str]:
        return {"ped": "_ped", "veh": "_veh"} if filtered else self.raw_ending


@dataclass(frozen=True)
class CitrDataset(VehicleCrowdDataset):
    """CITR: a golf cart among people who were told where to walk."""

    name: ClassVar[str] = "citr"
    location: ClassVar[str] = "columbus"
    expects: ClassVar[str] = "filtered/<clip>_ped.csv[.gz]"
    frames_per_second: ClassVar[float] = 29.97
    vehicle: ClassVar[Mode] = Mode.CART
    raw_ending: ClassVar[Mapping[str, str]] = {"veh": "_v1"}

    # with this salt pedestrians and cart have their share of the windows in train, val and test
    split: RecordingSplit = field(default_factory=lambda: RecordingSplit(salt="44"))

    def metres_per_unit(self, clip: str) -> float:
        """One: the raw positions are in m."""
        return 1.0


@dataclass(frozen=True)
class DutDataset(VehicleCrowdDataset):
    """DUT: students and cars on a campus; raw positions are pixels, `ratios.csv` has their size."""

    name: ClassVar[str] = "dut"
    location: ClassVar[str] = "dalian"
    expects: ClassVar[str] = "filtered/<clip>_ped.csv[.gz]"
    frames_per_second: ClassVar[float] = 23.98
    vehicle: ClassVar[Mode] = Mode.CAR
    raw_ending: ClassVar[Mapping[str, str]] = {"ped": "_ped", "veh": "_veh"}

    def settings(self) -> Mapping[str, object]:
        """Split, which tracks, and the scales."""
        return {**super().settings(), "pixels_per_metre": self._pixels_per_metre}

    def metres_per_unit(self, clip: str) -> float:
        """Length of a pixel in m.

        Raises:
            TrackError: If `ratios.csv` does not tell it.
        """
        ratio = self._pixels_per_metre.get(clip, float("nan"))
        finest, coarsest = METRES_PER_PIXEL
        if not 1.0 / coarsest <= ratio <= 1.0 / finest:
            where, remedy = self.root / "ratios.csv", "Raw positions are pixels: add its scale."
            needs = f"hold the pixels_per_metre of {clip}, {1 / coarsest:g} to {1 / finest:g}"
            refuse_track(RejectReason.SCALE, "ratios", needs, ratio, where, remedy)
        return 1.0 / ratio

    @cached_property
    def _pixels_per_metre(self) -> dict[str, float]:
        table = read_by_name(self.root / "ratios.csv", ("clip",), ("pixels_per_metre",))
        return {_plain(clip): ratio for clip, (ratio,) in table.items()}


def _plain(clip: str) -> str:
    """Name of a clip as that of its scene, which has no "-"."""
    return clip.replace("-", "_")
