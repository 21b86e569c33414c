"""Sizes of the bounded LQRs, and how their times are taken."""

import time
from typing import NamedTuple

import numpy as np

STEPS, N, M = 20, 8, 4


class Measured(NamedTuple):
    """What a solver needs for all problems, and what it finds."""

    alone_ms: float
    controls: np.ndarray
    both_ms: float | None = None  # with the gradient
    slopes: np.ndarray | None = None  # of the sum of the first controls, by what it has slopes


def fastest(work, limit_s=20.0, most=10):
    """Smallest processor time of the repetitions after the first call, in ms, and the last result."""
    result, times, began = work(), [], time.monotonic()
    while not times or (len(times) < most and time.monotonic() - began < limit_s):
        start = time.process_time()
        result = work()
        times.append(1e3 * (time.process_time() - start))
    return min(times), result
