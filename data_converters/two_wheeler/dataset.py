"""Two-wheeler recordings as scenes: pieces of one ride each, dealt to the splits in turn."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from data_converters.errors import TrackError, require
from data_converters.recordings import RawScene, RecordingDataset, SceneSource
from data_converters.tracks import RawTrack
from data_converters.two_wheeler.reader import Boxes, lean_to_the_left, read_boxes
from dmmv_conventions.cache import LEAN_TABLE
from dmmv_conventions.modes import Mode

FILE_MODES = {
    "bicycle": Mode.BICYCLE,
    "motorcycle": Mode.MOTORCYCLE,
    "scooter": Mode.SCOOTER,
}
TURNS = ("train", "test", "train", "val")
"""Splits of successive pieces of a ride."""


class _Rides(NamedTuple):
    """By file stem: the boxes of usable files and the faults of others."""

    boxes: dict[str, Boxes]
    faults: dict[str, TrackError]


@dataclass(frozen=True)
class TwoWheelerDataset(RecordingDataset):
    """The two-wheeler recordings: one ride per vehicle, cut into pieces that share no sample.

    The measured lean has no place in a trajdata cache; it is written beside the agents of a scene
    as `lean.parquet` with the columns `agent_id`, `time_s` (s, on the clock of the scene) and
    `lean` (rad, positive to the left).

    Attributes:
        root: Folder with bicycle.csv, motorcycle.csv and scooter.csv; at least one of them.
        piece_s: Length of a piece in s; of four pieces two are train, one val and one test.

    Raises:
        ConversionError: If `piece_s` is not positive.
    """

    name: ClassVar[str] = "two_wheeler"
    location: ClassVar[str] = "karlsruhe"

    piece_s: float = 10.0

    def __post_init__(self) -> None:
        require(self.piece_s > 0.0, "piece_s", "be positive", self.piece_s, "", "Try 10.")

    def settings(self) -> Mapping[str, object]:
        """Length of a piece."""
        return {"piece_s": self.piece_s}

    def scenes(self) -> list[SceneSource]:
        """One scene per piece; a file that cannot be read has one, so that it is counted.

        Raises:
            ConversionError: If none of the files is there.
        """
        rides = self._rides
        names = ", ".join(f"{stem}.csv" for stem in FILE_MODES)
        remedy = "Give the folder of the two-wheeler recordings."
        found = bool(rides.boxes or rides.faults)
        require(found, "root", f"hold one of {names}", "none", self.root, remedy)
        pieces = [
            SceneSource(
                f"{stem}_{number}", TURNS[number % len(TURNS)], f"{stem}/{number}", mark, stem
            )
            for stem, boxes in rides.boxes.items()
            for mark in [hashlib.sha256(np.concatenate(boxes, axis=None).tobytes()).hexdigest()]
            for number in np.unique(self._piece(boxes)).tolist()
        ]
        return pieces + [SceneSource(stem, TURNS[0], stem, "") for stem in rides.faults]

    def read(self, scene: SceneSource, dt_s: float, *, strict: bool) -> RawScene:
        """One piece of a ride with its lean.

        Raises:
            TrackError: When `strict`, if the file cannot be used.
        """
        raw = RawScene()
        stem, _, number = scene.key.partition("/")
        source = str(self.root / f"{stem}.csv")
        if stem in self._rides.faults:
            raw.reject("track", source, self._rides.faults[stem], strict=strict)
            return raw
        boxes = self._rides.boxes[stem]
        part = self._piece(boxes) == int(number)
        time_s = boxes.time_s[part] - boxes.time_s[part][0]
        velocity = CubicSpline(boxes.time_s, boxes.ground[:, :2])(boxes.time_s[part], 1)
        lean = lean_to_the_left(boxes.upright[part], velocity)
        table = pd.DataFrame({"agent_id": "track", "time_s": time_s, "lean": lean})
        raw.side_tables[LEAN_TABLE] = table
        raw.tracks.append(RawTrack("track", FILE_MODES[stem], time_s, boxes.ground[part], source))
        return raw

    @cached_property
    def _rides(self) -> _Rides:
        rides = _Rides({}, {})
        for stem in FILE_MODES:
            path = self.root / f"{stem}.csv"
            if path.exists() or path.is_symlink():
                try:
                    rides.boxes[stem] = read_boxes(path, self.limits)
                except TrackError as error:
                    rides.faults[stem] = error
        return rides

    def _piece(self, boxes: Boxes) -> np.ndarray:
        """Number (n,) of the piece of each sample; a short rest belongs to the piece before it."""
        since = boxes.time_s - boxes.time_s[0]
        last = max(int((since[-1] + 0.5 * self.piece_s) // self.piece_s) - 1, 0)
        return np.minimum((since // self.piece_s).astype(np.int64), last)
