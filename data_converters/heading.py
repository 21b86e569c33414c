"""Heading of an agent: along its cuboid if it has one, else along its motion, held at rest."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.smoothing import Smoother

Array = NDArray[np.float64]


class HeadingSource(IntEnum):
    """Where the heading of a row comes from; column `heading_source` of the cache."""

    MEASURED = 0
    HELD = 1
    BACKFILLED = 2
    UNKNOWN = 3


class HeadingTrack(NamedTuple):
    """Heading (n,) in rad, counter-clockwise from east, in [-pi, pi), and its source (n,)."""

    angle: Array
    source: NDArray[np.int8]


def wrap(angle: Array) -> Array:
    """Angle in rad brought to [-pi, pi), any shape (*b)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def direction(vectors: Array) -> Array:
    """Angle (n,) in rad of vectors (n, 2), counter-clockwise from their first axis.

    Where there are gaps between the numbers of an input, numpy chooses one of two loops, which
    differ in the last bits, by where the result happens to lie in memory. Without gaps every run
    has the same bits.
    """
    first, second = np.ascontiguousarray(vectors.T)
    return np.arctan2(second, first)


def heading_from_motion(velocity: Array, standstill_mps: float, *, backfill: bool) -> HeadingTrack:
    """Direction of the velocity; held while the agent is slower than `standstill_mps`.

    Before the first motion the heading of that first motion is used (a cyclist cannot turn on the
    spot), unless `backfill` is off because that would look into the future. An agent that never
    moves gets 0.

    Args:
        velocity: (n, 2) m/s, smoothed.
        standstill_mps: Speed in m/s below which the direction of motion is noise.
        backfill: Whether rows before the first motion take its heading.

    Returns:
        Heading in rad and its source per row.
    """
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) >= standstill_mps
    source = np.where(moving, HeadingSource.MEASURED, HeadingSource.HELD).astype(np.int8)
    if not moving.any():
        return HeadingTrack(
            np.zeros(len(velocity)), np.full(len(velocity), HeadingSource.UNKNOWN, np.int8)
        )
    angle = direction(velocity)
    start = int(np.argmax(moving))
    latest = np.maximum.accumulate(np.where(moving, np.arange(len(angle)), start))
    angle = angle[latest]
    source[:start] = HeadingSource.BACKFILLED if backfill else HeadingSource.UNKNOWN
    if not backfill:
        angle[:start] = 0.0
    return HeadingTrack(wrap(angle), source)


def heading_from_axis(
    axis: Array,
    time_s: Array,
    at_s: Array,
    velocity: Array,
    smoother: Smoother,
    standstill_mps: float,
) -> HeadingTrack:
    """Heading along a measured body axis whose direction is known up to half a turn.

    The doubled angle is smoothed as a unit vector, which is blind to half turns; the sign follows
    the motion: the one that agrees with most of the distance travelled, of which a smoother without
    look-ahead sees what was travelled so far.

    Args:
        axis: (n,) rad, modulo pi, at `time_s` (n,) s.
        time_s: Times of the samples.
        at_s: (m,) s, times of the result.
        velocity: (m, 2) m/s at `at_s`.
        smoother: Smoother of the positions.
        standstill_mps: Speed in m/s from which motion decides the sign.

    Returns:
        Heading in rad at `at_s`; unknown in sign, and marked so, for an agent that never
        moves, or has not moved yet.
    """
    doubled = np.column_stack([np.cos(2.0 * axis), np.sin(2.0 * axis)])
    smooth = smoother(time_s, doubled, at_s).value
    angle = np.unwrap(direction(smooth)) / 2.0
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    moving = speed >= standstill_mps
    along = velocity[:, 0] * np.cos(angle) + velocity[:, 1] * np.sin(angle)
    agrees, moved = np.cumsum(np.where(moving, along, 0.0)), np.logical_or.accumulate(moving)
    if smoother.lookahead_s > 0.0:
        agrees, moved = np.full_like(agrees, agrees[-1]), np.full_like(moved, moved[-1])
    source = np.where(moved, HeadingSource.MEASURED, HeadingSource.UNKNOWN).astype(np.int8)
    return HeadingTrack(wrap(angle + np.pi * (agrees < 0.0)), source)


def heading_measured(
    heading: Array, time_s: Array, at_s: Array, smoother: Smoother
) -> HeadingTrack:
    """Smooth a recorded heading (n,) rad at `time_s` (n,) s as a unit vector.

    Returns:
        Heading in rad at `at_s` (m,) s.
    """
    vector = smoother(time_s, np.column_stack([np.cos(heading), np.sin(heading)]), at_s).value
    angle = direction(vector)
    return HeadingTrack(wrap(angle), np.full(len(angle), HeadingSource.MEASURED, np.int8))
