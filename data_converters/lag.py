"""Positions of a cache without the lag of the causal smoother that they went through.

The rows y of a track are y = S x, with the smoother S, which is linear, and the recorded samples
x = m + e, the motion m and white noise e. The smoother lags, and does so the more the faster the
motion changes: no shift in time undoes that. The motion is estimated from the rows by generalised
least squares with small third differences D m,

    min_m (y - S m)ᵀ (S Sᵀ)⁻¹ (y - S m) + λ |D m|²,

as the solution of the sparse equations

    [ S Sᵀ    S     ] [ z ]   [ y ]
    [ Sᵀ    -λ DᵀD  ] [ m ] = [ 0 ].

Where S can be inverted (behind the first window of a track it can), this is Whittaker's smoother of
the samples themselves: without lag, and with half of the amplitude at `CUTOFF_HZ`.

Source: Eilers, A perfect smoother, Analytical Chemistry 75, 2003 (Whittaker's smoother).
"""

from __future__ import annotations

from math import ceil, floor, pi, sin

import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import spsolve

from data_converters.smoothing import SAME_TIME_S, Array, CausalSmoother
from data_converters.tracks import Sampling

CUTOFF_HZ = 3.0
"""Where half of an amplitude is left: vehicles turn more slowly than that."""

ORDER = 3
"""Of the differences that are kept small: acceleration may be steady at no cost."""

ROUNDING = 1e-3
"""Variance of a row beside that of a sample, beyond what the smoother leaves of the noise."""

SAME_CLOCK = 0.02
"""Relative deviation up to which a recorded step counts as a multiple or part of that of rows."""


def from_the_first_sample(smoother: CausalSmoother, dt_s: float, recorded_s: float) -> Sampling:
    """Sampling of a track of which only the usual step is known: its first sample was at a row.

    Args:
        smoother: What the track went through.
        dt_s: Step of the rows in s.
        recorded_s: Step of the recording in s.
    """
    recorded_s = _on_the_clock(recorded_s, dt_s)
    ready_s = smoother.ready_s(recorded_s * np.arange(_enough(smoother, recorded_s)))
    return Sampling(dt_s * ceil(ready_s / dt_s - 1e-6), recorded_s)


def without_lag(smoother: CausalSmoother, rows: Array, dt_s: float, sampling: Sampling) -> Array:
    """Rows of a causally smoothed track without the lag of the smoother.

    Args:
        smoother: What the track went through.
        rows: (T, k), from the first one on that the smoother put out.
        dt_s: Step of the rows in s.
        sampling: When the track was sampled; its step is taken for regular.

    Returns:
        Of shape (T, k). Within the first `smoother.window_s` they owe much to samples before the
        first row, which are not known, and are several times less certain.
    """
    lead_s, step_s = sampling
    enough = _enough(smoother, step_s)
    # samples that were not quite regular may have been enough a little earlier
    ready_s = smoother.ready_s(step_s * np.arange(enough))
    at_s = max(lead_s, ready_s) + dt_s * np.arange(len(rows))
    time_s = step_s * np.arange(max(floor(at_s[-1] / step_s + 1e-6) + 1, enough))
    # a smoother keeps constants: far from the origin, less is lost by rounding
    origin = rows[:1]
    motion = _motion(response(smoother, time_s, at_s), rows - origin, step_s)
    return CubicSpline(time_s, motion)(at_s) + origin


def _motion(passed: sparse.coo_array, rows: Array, step_s: float) -> Array:
    """The motion (n, k) at the samples, of rows (T, k) that the smoother `passed` (T, n)."""
    count, samples = passed.shape
    covariance = passed @ passed.T + ROUNDING * sparse.eye_array(count)
    changes = sparse.csr_array(sparse.eye_array(samples))
    for _ in range(ORDER):
        changes = sparse.csr_array(changes[1:] - changes[:-1])
    weight = (2.0 * sin(pi * min(CUTOFF_HZ * step_s, 0.5))) ** (-2 * ORDER)
    equations = sparse.block_array(
        [[covariance, passed], [passed.T, -weight * (changes.T @ changes)]], format="csc"
    )
    right = np.vstack([rows, np.zeros((samples, rows.shape[1]))])
    return np.asarray(spsolve(equations, right))[count:]


def response(smoother: CausalSmoother, time_s: Array, at_s: Array) -> sparse.coo_array:
    """The smoother as a matrix (m, n): its values at `at_s` (m,) s of samples at `time_s` (n,) s.

    A value depends on the latest samples alone, so that those which are farther apart than that
    are smoothed together, as one series.

    Args:
        smoother: The smoother.
        time_s: (n,) s, of equal steps.
        at_s: (m,) s, none within the warm-up.
    """
    reach = ceil(smoother.window_s / (time_s[1] - time_s[0])) + smoother.order + 3
    trains = np.eye(reach)[np.arange(len(time_s)) % reach]
    found = smoother(time_s, trains, at_s).value
    latest = np.searchsorted(time_s, at_s + SAME_TIME_S, side="right") - 1
    sample = latest[:, None] - np.arange(reach)
    row = np.broadcast_to(np.arange(len(at_s))[:, None], sample.shape)
    known = sample >= 0
    weight = found[row, sample % reach][known]
    return sparse.coo_array((weight, (row[known], sample[known])), shape=(len(at_s), len(time_s)))


def _enough(smoother: CausalSmoother, step_s: float) -> int:
    """Samples of a track that is long enough for the smoother."""
    return ceil(smoother.window_s / step_s) + smoother.samples_needed


def _on_the_clock(recorded_s: float, dt_s: float) -> float:
    """The recorded step, or the multiple or part of the step of rows that it nearly is."""
    ratio = max(recorded_s, dt_s) / min(recorded_s, dt_s)
    whole = round(ratio)
    if abs(ratio - whole) > SAME_CLOCK * whole:
        return recorded_s
    return dt_s * whole if recorded_s > dt_s else dt_s / whole
