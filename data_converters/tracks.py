"""One track as recorded, its gap-free stretches, and the rows that become of each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from itertools import chain, count
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_converters.errors import require
from data_converters.smoothing import CausalSmoother, Smoother
from dmmv_conventions.checks import require_switch
from dmmv_conventions.modes import Mode

if TYPE_CHECKING:
    from trajdata.data_structures.agent import FixedExtent

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RawTrack:
    """One track as recorded, in the units of the cache.

    Attributes:
        name: Name of the agent within its scene, ASCII.
        mode: Its mode of travel.
        time_s: (n,) s on the clock of the scene, increasing.
        position: (n, 3) m, x east, y north, z up.
        source: File it was read from, for messages and the report.
        extent: Measured size in m, None where unknown.
        axis: (n,) rad, measured direction of the longer side modulo pi, None where unknown.
        speed: (n,) m/s as stated by the recording, only checked against; None where absent.
        heading: (n,) rad as stated by the recording, counter-clockwise from east; None where
            absent.
    """

    name: str
    mode: Mode
    time_s: Array
    position: Array
    source: str
    extent: FixedExtent | None = None
    axis: Array | None = None
    speed: Array | None = None
    heading: Array | None = None


@dataclass(frozen=True)
class ResampleSettings:
    """How tracks become rows.

    Attributes:
        dt_s: Step of the cache in s.
        max_gap_s: Longest gap in s that is interpolated; longer ones split the track.
        min_duration_s: Shortest stretch in s that is kept.
        standstill_mps: Speed in m/s below which the heading is held.
        smoother: Smoother of positions; the causal one sees nothing of the future.
        backfill_heading: Whether rows before the first motion take its heading, which looks into
            the future; off, they get 0. A causal smoother never does.

    Raises:
        ConversionError: If a number is not positive.
    """

    dt_s: float = 0.1
    max_gap_s: float = 0.5
    min_duration_s: float = 1.0
    standstill_mps: float = 0.4
    smoother: Smoother = field(default_factory=CausalSmoother)
    backfill_heading: bool = True

    def __post_init__(self) -> None:
        for name in ("dt_s", "max_gap_s", "min_duration_s", "standstill_mps"):
            value = getattr(self, name)
            require(value > 0.0, name, "be positive", value, "", "Give SI units.")
        require_switch("backfill_heading", self.backfill_heading)


class Residual(NamedTuple):
    """Sums over moving raw samples.

    Attributes:
        count: Number of samples.
        along: Squared residual of the smoother along the motion in m².
        across: The same across the motion.
        white: Squared residual that white noise of variance 1 leaves at these samples: what the
            smoother cannot follow. Noise has the variance `along / white`, or `across / white`.
        seconds: Time they cover in s, `count` usual steps.
    """

    count: int
    along: float
    across: float
    white: float
    seconds: float


class Sampling(NamedTuple):
    """When a gap-free stretch was sampled, beside its rows.

    Attributes:
        lead_s: Time in s from the first sample to the first row.
        step_s: Usual time in s between two samples.
    """

    lead_s: float
    step_s: float

    @classmethod
    def of(cls, time_s: Array, first_row_s: float) -> Sampling:
        """That of samples at `time_s` (n,) s of which some may be missing."""
        span_s = float(time_s[-1] - time_s[0])
        steps = max(round(span_s / float(np.median(np.diff(time_s)))), 1)
        return cls(first_row_s - float(time_s[0]), span_s / steps)


class AgentRows(NamedTuple):
    """One gap-free stretch of an agent.

    `rows` has one row per step from `first_step` on: x, y, z (m), vx, vy (m/s), ax, ay (m/s²),
    heading (rad), interpolated (bool), heading_source (see `HeadingSource`).
    """

    name: str
    mode: Mode
    extent: FixedExtent
    first_step: int
    rows: pd.DataFrame
    residual: Residual
    speed_error: float
    sampling: Sampling


def split_at_gaps(track: RawTrack, max_gap_s: float, taken: Collection[str] = ()) -> list[RawTrack]:
    """Stretches of a track between gaps longer than `max_gap_s` s.

    Later ones get _s1, _s2 and so on, without the names that are `taken` by other agents.
    """
    cuts = np.flatnonzero(np.diff(track.time_s) > max_gap_s + 1e-6) + 1
    bounds = [0, *cuts.tolist(), len(track.time_s)]
    later = (f"{track.name}_s{number}" for number in count(1))
    names = chain([track.name], (name for name in later if name not in taken))
    parts = zip(names, bounds[:-1], bounds[1:], strict=False)
    return [_stretch(track, slice(begin, end), name) for name, begin, end in parts]


def _stretch(track: RawTrack, part: slice, name: str) -> RawTrack:
    return replace(
        track,
        name=name,
        time_s=track.time_s[part],
        position=track.position[part],
        axis=None if track.axis is None else track.axis[part],
        speed=None if track.speed is None else track.speed[part],
        heading=None if track.heading is None else track.heading[part],
    )
