"""Cutting recorded tracks into segments of steady motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least, require_positive
from diffstack_mmv.geometry import direction, wrap_angle
from diffstack_mmv.identification.tracks.segments import TrackSegment
from diffstack_mmv.types import Motion

UNSMOOTHED = ("none", "Unsmoothed")
"""How the name of a smoother begins that is none."""

MOST_APART = 1.5
"""Factor between the way of tracks and what their velocities make of it: a wrong unit or step."""


class Recordings(NamedTuple):
    """Whole tracks of one mode of transport, by name, with what was measured beside them."""

    motions: Mapping[str, Motion]  # (T)
    leans: Mapping[str, Float[Tensor, " T"]] | None = None  # rad, of some tracks
    controls: Mapping[str, Float[Tensor, "T m"]] | None = None  # NaN where there are none
    noise_m: tuple[float, float] | None = None  # of a position, along and across the motion
    smoother: str = "none"
    parts_of: Mapping[str, str] | None = None  # recording of a scene, where one holds several

    @property
    def smoothed(self) -> bool:
        """Whether positions went through a smoother, so that their errors are correlated."""
        return not self.smoother.startswith(UNSMOOTHED)


@dataclass(frozen=True)
class SegmentSettings:
    """What a segment must be.

    Args:
        dt_s: Step of the tracks.
        min_s: Shortest segment.
        max_s: Longer motion is cut into segments of that length.
        speed_min_mps: A slower sample ends the segment: near standstill a course says nothing.
        trim_s: Left out at both ends of a track, where its smoother looked past the end.

    Raises:
        ValueError: A number is not positive and finite, or the shortest is longer than the longest.
    """

    dt_s: float = 0.1
    min_s: float = 3.0
    max_s: float = 6.0
    speed_min_mps: float = 1.0
    trim_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("dt_s", "min_s", "max_s", "speed_min_mps"):
            require_positive(name, getattr(self, name))
        require_at_least("max_s", self.max_s, self.min_s)
        require_at_least("trim_s", self.trim_s, 0.0)


def cut_tracks(recordings: Recordings, settings: SegmentSettings) -> list[TrackSegment]:
    """Cut tracks into segments of steady motion, one after the other without overlap.

    Args:
        recordings: The tracks. If controls were recorded, segments have them all along.
        settings: What a segment must be.

    Raises:
        ValueError: No track holds a segment of the shortest length, the noise is no pair, what was
            measured beside a track is of another length, or of no track, or positions do not move
            as the velocities say, as those of another step.
    """
    _require_rows(recordings)
    longest = round(settings.max_s / settings.dt_s) + 1
    shortest = round(settings.min_s / settings.dt_s) + 1
    segments = []
    for name, motion in recordings.motions.items():
        beside = _BesideMotion.of(recordings, name)
        part_of = (recordings.parts_of or {}).get(name.partition("/")[0], "")
        for first, last in _runs(_usable(motion, beside, recordings, settings)):
            for start in range(first, last - shortest + 1, longest):
                rows = slice(start, min(start + longest, last))
                if rows.stop - start >= shortest:
                    segment = _segment(name, motion, beside, rows, settings.dt_s)
                    segments.append(segment._replace(part_of=part_of))
    _require_some(segments, recordings, settings)
    _require_one_motion(segments, settings.dt_s)
    return segments


def _require_rows(recordings: Recordings) -> None:
    """Refuse no tracks, and what was measured beside one without a row for each of its times."""
    motions, noise = recordings.motions, recordings.noise_m
    require(len(motions) > 0, "motions", "hold at least one track", "none")
    pair = noise is None or (isinstance(noise, Sequence) and len(noise) == 2)
    require(pair, "noise_m", "be a pair in m, along and across the motion", noise)
    for kind in ("leans", "controls"):
        for name, rows in (getattr(recordings, kind) or {}).items():
            require(name in motions, kind, f"be of tracks such as {next(iter(motions))!r}", name)
            wanted, found = len(motions[name].heading), len(rows)
            where = f"for track {name!r}"
            require(found == wanted, kind, f"have {wanted} rows, one per time", found, where)


def _usable(
    motion: Motion, beside: "_BesideMotion", recordings: Recordings, settings: SegmentSettings
) -> Bool[Tensor, " T"]:
    """Where a track is fast enough, away from its ends, and has all that was asked for."""
    usable = motion.velocity.norm(dim=-1) >= settings.speed_min_mps
    trim = round(settings.trim_s / settings.dt_s)
    usable[:trim] = False
    usable[max(len(usable) - trim, 0) :] = False
    if recordings.controls is None:
        return usable
    if beside.controls is None:
        return torch.zeros_like(usable)
    return usable & beside.controls.isfinite().all(-1)


def _require_some(
    segments: Sequence[TrackSegment], recordings: Recordings, settings: SegmentSettings
) -> None:
    motions = recordings.motions.values()
    longest_s = max(len(motion.heading) for motion in motions) * settings.dt_s
    known = "" if recordings.controls is None else " with recorded controls"
    require(
        len(segments) > 0,
        "tracks",
        f"hold a segment of {settings.min_s:g} s above {settings.speed_min_mps:g} m/s{known}",
        f"{len(motions)} tracks, the longest of {longest_s:g} s, without one",
        remedy="Lower `stretch.min_s` or `stretch.speed_min_mps`.",
    )


def _require_one_motion(segments: Sequence[TrackSegment], dt_s: float) -> None:
    """Refuse tracks of another step, and headings and velocities of another unit or frame.

    The way along the course does not grow with the noise of positions.
    """
    way_m, told_m = 0.0, 0.0
    for each in segments:
        course, speed = direction(each.course[:-1]), each.speed[:-1]
        way_m += float((each.position.diff(dim=0) * course).sum())
        told_m += dt_s * float(speed.sum())
    share = way_m / told_m
    wanted = f"move as their velocities say in steps of {dt_s:g} s"
    remedy = "Give their step as `dt_s`, velocities in the frame of the body in m/s, and radians."
    fits = 1 / MOST_APART < share < MOST_APART
    require(fits, "motions", wanted, f"{share:.2g} times as far along them", "", remedy)


def _runs(moving: Bool[Tensor, " T"]) -> list[tuple[int, int]]:
    """First and past-the-last row of every uninterrupted run of usable samples."""
    edges = torch.nn.functional.pad(moving.int(), (1, 1)).diff().nonzero().flatten().tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


class _BesideMotion(NamedTuple):
    """What was measured of a track beside its motion."""

    lean: Float[Tensor, " T"] | None
    controls: Float[Tensor, "T m"] | None

    @classmethod
    def of(cls, recordings: Recordings, name: str) -> "_BesideMotion":
        return cls((recordings.leans or {}).get(name), (recordings.controls or {}).get(name))

    def part(self, rows: slice) -> "_BesideMotion":
        return _BesideMotion(*(None if each is None else each[rows] for each in self))


def _segment(
    name: str, motion: Motion, beside: _BesideMotion, rows: slice, dt_s: float
) -> TrackSegment:
    velocity, measured = motion.velocity[rows], beside.part(rows)
    course = motion.heading[rows] + torch.atan2(velocity[:, 1], velocity[:, 0])
    turned = wrap_angle(course.diff()).cumsum(0)
    course = torch.cat([course[:1], course[0] + turned])
    return TrackSegment(
        f"{name}@{rows.start * dt_s:.1f}s",
        motion.position[rows],
        course,
        velocity.norm(dim=-1),
        measured.controls,
        measured.lean,
    )
