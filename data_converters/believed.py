"""Samples of a live track that are believed: no strays, no jumps, no other unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_converters.errors import require
from data_converters.limits import RecordingLimits
from dmmv_conventions.modes import Mode

ENOUGH_STEPS = 5
"""Steps of a track from which on its unit is judged."""


@dataclass(frozen=True)
class Believed:
    """What of a live track is believed; its samples (time in s, x and y in m, mode) rise in time.

    Attributes:
        limits: Speeds that are believed.
        max_gap_s: Longest time between two samples of one stretch.
    """

    limits: RecordingLimits
    max_gap_s: float

    def stretch(self, samples: pd.DataFrame, where: str) -> pd.DataFrame:
        """Samples of an agent since its last gap or lasting jump.

        A single sample that lies apart from both its neighbors is left out, and so is the last one
        where it jumps: the next will tell whether a tracker took one for another.

        Args:
            samples: Of the agent.
            where: The track, for messages.

        Raises:
            ConversionError: Two samples have one time.
        """
        same = int((np.diff(samples["time"].to_numpy(float)) <= 0.0).sum())
        require(same == 0, "time", "differ from sample to sample", f"{same} repeated", where)
        into = self._jumps(samples)
        stray = np.zeros(len(samples), dtype=np.bool_)
        stray[1:-1] = into[:-1] & into[1:] & ~self._jumps(samples, 2)
        stray[-1] = into[-1:].any() and not stray[-2:-1].any()
        samples = samples.iloc[~stray]
        gaps = np.diff(samples["time"].to_numpy(float)) > self.max_gap_s + 1e-6
        breaks = np.flatnonzero(self._jumps(samples) | gaps)
        return samples.iloc[int(breaks[-1]) + 1 if len(breaks) else 0 :]

    def require_metres(self, samples: pd.DataFrame, where: str) -> None:
        """Refuse whoever is nearly always too fast: positions have another unit.

        Raises:
            TrackError: More than half of five steps or more are too long.
        """
        jumps = self._jumps(samples)
        if len(jumps) >= ENOUGH_STEPS and 2 * jumps.sum() > len(jumps):
            time_s, place = samples["time"].to_numpy(float), samples[["x", "y"]].to_numpy(float)
            self.limits.check_steps(time_s, place, _mode(samples), where)

    def _jumps(self, samples: pd.DataFrame, apart: int = 1) -> NDArray[np.bool_]:
        """Whether samples so many rows apart are farther apart than anybody of the mode travels."""
        if len(samples) <= apart:
            return np.zeros(0, dtype=np.bool_)
        time_s, place = samples["time"].to_numpy(float), samples[["x", "y"]].to_numpy(float)
        moved = np.hypot(*(place[apart:] - place[:-apart]).T)
        return self.limits.too_far(moved, time_s[apart:] - time_s[:-apart], _mode(samples))


def _mode(samples: pd.DataFrame) -> Mode:
    return Mode.named(str(samples["mode"].iloc[-1]))
