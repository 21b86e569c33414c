"""Samples of a live track that are believed: no strays, no jumps, no other unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.errors import require
from data_converters.limits import RecordingLimits
from dmmv_conventions.modes import Mode

Array = NDArray[np.float64]

ENOUGH_STEPS = 5
"""Steps of a track from which on its unit is judged."""


class Samples(NamedTuple):
    """Samples of one agent, rising in time."""

    time_s: Array  # n, s
    place: Array  # n 2, m
    modes: NDArray[np.object_]  # n, as they were told
    size: Array | None  # n 2, length and width in m where they are measured

    def taken(self, index: NDArray[np.integer] | NDArray[np.bool_] | slice) -> Samples:
        """Some of the samples, by numbers or by truths of the shape (n,)."""
        size = None if self.size is None else self.size[index]
        return Samples(self.time_s[index], self.place[index], self.modes[index], size)


@dataclass(frozen=True)
class Believed:
    """What of a live track is believed.

    Attributes:
        limits: Speeds that are believed.
        max_gap_s: Longest time between two samples of one stretch.
    """

    limits: RecordingLimits
    max_gap_s: float

    def stretch(self, samples: Samples, where: str) -> Samples:
        """Samples of an agent since its last gap or lasting jump.

        A single sample that lies apart from both its neighbors is left out, and so is the last one
        where it jumps: the next will tell whether a tracker took one for another.

        Args:
            samples: Of the agent.
            where: The track, for messages.

        Raises:
            ConversionError: Two samples have one time.
        """
        same = int((np.diff(samples.time_s) <= 0.0).sum())
        require(same == 0, "time", "differ from sample to sample", f"{same} repeated", where)
        into = self._jumps(samples)
        stray = np.zeros(len(samples.time_s), dtype=np.bool_)
        stray[1:-1] = into[:-1] & into[1:] & ~self._jumps(samples, 2)
        stray[-1] = into[-1:].any() and not stray[-2:-1].any()
        samples = samples.taken(~stray)
        gaps = np.diff(samples.time_s) > self.max_gap_s + 1e-6
        breaks = np.flatnonzero(self._jumps(samples) | gaps)
        return samples.taken(slice(int(breaks[-1]) + 1 if len(breaks) else 0, None))

    def require_seconds(self, samples: Samples, where: str) -> None:
        """Refuse whoever is hardly ever seen twice within a gap: times have another unit.

        Raises:
            ConversionError: Half of five steps or more are longer than a gap may be.
        """
        steps = np.diff(samples.time_s)
        usual_s = float(np.median(steps)) if len(steps) >= ENOUGH_STEPS else 0.0
        needs = f"rise by at most {self.max_gap_s:g} s from sample to sample"
        remedy = "Give seconds, or raise `max_gap_s`."
        fits = usual_s <= self.max_gap_s + 1e-6
        require(fits, "time", needs, f"{usual_s:g} s as a rule", where, remedy)

    def require_metres(self, samples: Samples, where: str) -> None:
        """Refuse whoever is nearly always too fast: positions have another unit.

        Raises:
            TrackError: More than half of five steps or more are too long.
        """
        jumps = self._jumps(samples)
        if len(jumps) >= ENOUGH_STEPS and 2 * jumps.sum() > len(jumps):
            self.limits.check_steps(samples.time_s, samples.place, _mode(samples), where)

    def _jumps(self, samples: Samples, apart: int = 1) -> NDArray[np.bool_]:
        """Whether samples so many rows apart are farther apart than anybody of the mode travels."""
        time_s, place = samples.time_s, samples.place
        if len(time_s) <= apart:
            return np.zeros(0, dtype=np.bool_)
        moved = np.hypot(*(place[apart:] - place[:-apart]).T)
        return self.limits.too_far(moved, time_s[apart:] - time_s[:-apart], _mode(samples))


def _mode(samples: Samples) -> Mode:
    return Mode.named(samples.modes[-1])
