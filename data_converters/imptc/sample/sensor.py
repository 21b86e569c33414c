"""What a sensor makes of true motion: noise like that of real tracks, jittered clock, gaps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.imptc.sample.traffic import TrafficMotion

Array = NDArray[np.float64]

ALONG_M, ACROSS_M, STANDING_M = 0.08, 0.05, 0.035
"""Standard deviation of the position along and across the motion and at standstill: those of the
TH-AB cyclists, measured at the same kind of intersection."""

SLOPE = 0.045
"""Rise of the ground towards the east."""

STEPS_US = np.array([39_965, 39_978, 39_979, 40_000, 40_009])
STEP_SHARE = np.array([0.02, 0.03, 0.05, 0.8, 0.1])


class Detections(NamedTuple):
    """Noisy samples: index into the motion (n,), position (n, 3) m, heading rad, speed m/s."""

    index: NDArray[np.int64]
    position: Array
    heading: Array
    speed: Array


def master_clock(count: int, start_us: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Timestamps (count,) in µs: steps of 40 ms with the small jitter of the recordings."""
    steps = rng.choice(STEPS_US, size=count, p=STEP_SHARE)
    return start_us + np.concatenate([[0], np.cumsum(steps[1:])])


def detect(motion: TrafficMotion, longest_gap_s: float, rng: np.random.Generator) -> Detections:
    """Add noise to a motion and drop samples.

    Two in a hundred samples are missing; three tracks in ten have one longer gap of up to
    `longest_gap_s` s.
    """
    count = len(motion.step)
    share = np.minimum(motion.speed / 0.7, 1.0)
    along = rng.normal(size=count) * (STANDING_M + (ALONG_M - STANDING_M) * share)
    across = rng.normal(size=count) * (STANDING_M + (ACROSS_M - STANDING_M) * share)
    cosine, sine = np.cos(motion.heading), np.sin(motion.heading)
    x = motion.position[:, 0] + along * cosine - across * sine
    y = motion.position[:, 1] + along * sine + across * cosine
    z = SLOPE * motion.position[:, 0] + rng.normal(0.0, 0.02, count)
    seen = rng.random(count) > 0.02
    seen[[0, -1]] = True
    gap = int(rng.uniform(0.2, longest_gap_s) / 0.04)
    if rng.random() < 0.3 and count > gap + 100:
        start = int(rng.integers(50, count - gap - 25))
        seen[start : start + gap] = False
    index = np.flatnonzero(seen)
    heading = motion.heading + rng.normal(0.0, 0.03, count)
    speed = np.abs(motion.speed * rng.normal(1.0, 0.1, count) + rng.normal(0.0, 0.1, count))
    return Detections(index, np.column_stack([x, y, z])[index], heading[index], speed[index])


def cuboid_edges(position: Array, heading: float, extent_m: tuple[float, float, float]) -> Array:
    """The 12 edges (12, 2, 3) m of a box that stands on `position` (3,) m."""
    length, width, height = extent_m
    forward = np.array([np.cos(heading), np.sin(heading), 0.0]) * length / 2.0
    left = np.array([-np.sin(heading), np.cos(heading), 0.0]) * width / 2.0
    base = position + np.array([forward + left, forward - left, -forward - left, -forward + left])
    base[:, 2] += SLOPE * (base[:, 0] - position[0])
    top = base + np.array([0.0, 0.0, height])
    around = [(i, (i + 1) % 4) for i in range(4)]
    edges = [(corners[i], corners[j]) for corners in (base, top) for i, j in around]
    return np.array(edges + [(base[i], top[i]) for i in range(4)])
