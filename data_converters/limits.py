"""What a recording can hold at all: time, places and speeds beyond it are faults of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from data_converters.errors import RejectReason, refuse_track, require
from data_converters.tracks import AgentRows, RawTrack
from dmmv_conventions.checks import did_you_mean
from dmmv_conventions.modes import Mode

Array = NDArray[np.float64]

SPEED_MAX_MPS = MappingProxyType(
    {
        "unknown": 100.0,
        "car": 90.0,
        "pedestrian": 13.0,
        "bicycle": 30.0,
        "motorcycle": 100.0,
        "scooter": 30.0,
        "skateboard": 35.0,
        "cart": 20.0,
        "stroller": 13.0,
        "wheelchair": 20.0,
        "truck": 50.0,
    }
)
"""By mode in m/s: what nobody exceeds on a road, above the records of sprinters and racers."""

SIZES = ("length", "width", "height")
"""Sizes of an agent in m."""

OVERSHOOT = 1.25
"""Factor by which a smoothed speed may exceed the limit, because of noise."""

UNLIKELY = 5.0
"""Factor of the limit beyond which a usual speed tells of a wrong unit, not of a wrong mode."""

SMALL_UNITS = (("cm", 1e-2), ("mm", 1e-3))
"""Units in m that positions may have in the place of metres, the larger first."""


@dataclass(frozen=True)
class RecordingLimits:
    """Bounds of plausible recordings; a track beyond them is rejected, whatever its length.

    Attributes:
        span_s: Longest time in s between the first and the last sample of a scene.
        step_s: Largest usual (median) time in s between two samples of a track.
        rows: Largest number of steps of the common grid of a scene.
        coordinate_m: Largest distance in m from the origin of the frame, along any axis.
        extent_m: Largest length, width or height in m of an agent.
        speed_mps: Largest speed in m/s by mode; modes that are left out keep `SPEED_MAX_MPS`.
        slack_m: Distance in m that two samples may lie apart beyond that speed, because of noise.

    Raises:
        ConversionError: If a number is not positive or a mode is unknown.
    """

    span_s: float = 7200.0
    step_s: float = 5.0
    rows: int = 1_000_000
    coordinate_m: float = 1000.0
    extent_m: float = 30.0
    speed_mps: Mapping[str, float] = field(default_factory=dict)
    slack_m: float = 1.0

    def __post_init__(self) -> None:
        for name in ("span_s", "step_s", "rows", "coordinate_m", "extent_m", "slack_m"):
            value = getattr(self, name)
            require(value > 0.0, name, "be positive", value, "", "Give SI units.")
        for mode, speed in self.speed_mps.items():
            known, needs = list(SPEED_MAX_MPS), f"name {', '.join(SPEED_MAX_MPS)}"
            remedy = did_you_mean(str(mode), known) or "Correct the mode."
            require(mode in known, "speed_mps", needs, mode, "", remedy)
            require(speed > 0.0, f"speed_mps.{mode}", "be positive", speed, "", "Give m/s.")

    def speed_of(self, mode: Mode) -> float:
        """Largest speed of a mode in m/s."""
        return self.speed_mps.get(mode.label, SPEED_MAX_MPS[mode.label])

    def check_samples(self, time_s: Array, position: Array, where: object) -> None:
        """Refuse samples whose time or place cannot be.

        Args:
            time_s: (n,) s, finite, in any order.
            position: (n, k) m from the origin of the recording's own frame, finite.
            where: The file, for messages.

        Raises:
            TrackError: They last too long, lie too far apart in time, or too far away.
        """
        with np.errstate(over="ignore"):
            span = float(time_s.max() - time_s.min())
            usual = float(np.median(np.diff(np.sort(time_s)))) if len(time_s) > 1 else 0.0
        if span > self.span_s:
            needs, remedy = f"last at most {self.span_s:g} s", "Raise `span_s` if it really does."
            refuse_track(RejectReason.TIME_SPAN, "track", needs, f"{span:g} s", where, remedy)
        if usual > self.step_s:
            needs = f"have samples at most {self.step_s:g} s apart, as a rule"
            remedy = "Give seconds, or raise `step_s`."
            refuse_track(RejectReason.TIMESTAMP_UNIT, "track", needs, f"{usual:g}", where, remedy)
        farthest = float(np.abs(position).max())
        if farthest > self.coordinate_m:
            needs = f"lie within {self.coordinate_m:g} m of the origin"
            corner = ",".join(f"{low:.0f}" for low in position[:, :2].min(axis=0))
            remedy = (
                "Give metres, or raise `coordinate_m` (data.recordings.limits.coordinate_m). "
                f"For own tables in UTM or the like move data.units.origin_m by [{corner}]."
            )
            refuse_track(
                RejectReason.COORDINATES, "position", needs, f"{farthest:g}", where, remedy
            )

    def check(self, track: RawTrack, origin_m: tuple[float, float, float], dt_s: float) -> None:
        """Refuse a track that cannot be, as a whole.

        Args:
            track: The track with all its gaps.
            origin_m: Origin of the frame of the recording, in the frame of the track.
            dt_s: Step of the grid in s.

        Raises:
            TrackError: Time, place, size or speed lie beyond the limits.
        """
        self._check_extent(track)
        self.check_samples(track.time_s, track.position - np.array(origin_m), track.source)
        steps = float(track.time_s[-1]) / dt_s
        if steps > self.rows:
            needs = f"end within {self.rows} steps of {dt_s:g} s"
            remedy = "Convert with a larger `dt_s`."
            refuse_track(
                RejectReason.TIME_SPAN, "track", needs, f"{steps:.3g}", track.source, remedy
            )
        self.check_steps(track.time_s, track.position, track.mode, track.source)

    def check_steps(self, time_s: Array, position: Array, mode: Mode, where: object) -> None:
        """Refuse samples that are farther apart than anybody travels.

        Args:
            time_s: (n,) s, rising.
            position: (n, k) m, x and y first.
            mode: Mode of the agent.
            where: The track, for messages.

        Raises:
            TrackError: Two samples are too far apart.
        """
        moved = np.hypot(*np.diff(position[:, :2], axis=0).T)
        passed = np.diff(time_s)
        if self.too_far(moved, passed, mode).any():
            worst = int((moved - self.speed_of(mode) * passed).argmax())
            found = f"{moved[worst]:g} m in {passed[worst]:g} s"
            usual = float(np.median(moved / passed))
            self._refuse_speed(mode, found, f"{where}, sample {worst + 1}", usual)

    def too_far(self, moved_m: Array, passed_s: Array, mode: Mode) -> NDArray[np.bool_]:
        """Whether ways, (n,) m, are longer than anybody of a mode travels in the times, (n,) s."""
        return moved_m - self.speed_of(mode) * passed_s > self.slack_m

    def _check_extent(self, track: RawTrack) -> None:
        for name in () if track.extent is None else SIZES:
            size = float(getattr(track.extent, name))
            if not 0.0 < size <= self.extent_m:
                needs = f"be above 0 and at most {self.extent_m:g} m"
                remedy = "Give metres, or nothing where it is not known, or raise `extent_m`."
                where = f"{track.source}, agent {track.name}"
                refuse_track(RejectReason.EXTENT, name, needs, f"{size:g}", where, remedy)

    def check_rows(self, rows: AgentRows, where: object) -> None:
        """Refuse rows that the smoother could not make sense of.

        Raises:
            TrackError: A value is not finite, or the smoothed speed lies beyond the limit
                and what a smoother may add to it.
        """
        values = rows.rows[["x", "y", "z", "vx", "vy", "ax", "ay", "heading"]].to_numpy()
        if not np.isfinite(values).all():
            remedy = "Look at the clock of the file."
            refuse_track(
                RejectReason.NOT_FINITE, "rows", "be finite when smoothed", "NaN", where, remedy
            )
        self.check_smoothed(values[:, 3:5], rows.mode, where)

    def check_smoothed(self, velocity: Array, mode: Mode, where: object) -> None:
        """Refuse smoothed velocities beyond the limit and what a smoother may add to it.

        Args:
            velocity: (n, 2) m/s, finite.
            mode: Mode of the agent.
            where: The track, for messages.

        Raises:
            TrackError: One is too fast.
        """
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        if len(speed) and speed.max() > OVERSHOOT * self.speed_of(mode):
            found = f"{speed.max():g} m/s when smoothed"
            self._refuse_speed(mode, found, where, float(np.median(speed)))

    def _refuse_speed(self, mode: Mode, found: str, where: object, usual_mps: float) -> None:
        limit = self.speed_of(mode)
        needs = f"be at most {limit:g} m/s for mode '{mode.label}'"
        remedy = "Give metres and seconds, or raise `speed_mps`."
        if usual_mps > UNLIKELY * limit:
            fitting = [unit for unit, metres in SMALL_UNITS if usual_mps * metres <= limit]
            likely = f", as if positions were in {fitting[0]}" if fitting else ""
            remedy = f"It is {usual_mps:.3g} m/s as a rule{likely}. {remedy}"
        refuse_track(RejectReason.SPEED, "speed", needs, found, where, remedy)


USUAL = RecordingLimits()


def on_one_clock(first: Mapping[str, float], last: Mapping[str, float], span: float) -> set[str]:
    """Most tracks that fit within `span`; of equally many the later ones.

    Args:
        first: Time of the first sample by track.
        last: Time of the last sample by track.
        span: Longest time, in the same unit.

    Returns:
        Names of the tracks that share a clock.
    """
    chosen: set[str] = set()
    for begin in sorted(set(first.values())):
        fits = {name for name in first if begin <= first[name] and last[name] <= begin + span}
        if len(fits) >= len(chosen) and fits:
            chosen = fits
    return chosen
