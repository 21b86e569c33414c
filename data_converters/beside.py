"""Smoothed positions, and controls recorded beside them, as output and input of a vehicle.

Positions that are smoothed beside controls that are not come later, or turn less sharply, than the
controls say. A filter changes nothing in the relation between the input and the output of a linear
system as long as both pass through it, so controls pass through a smoother that has no lag. Behind
one that has, a vehicle is not linear enough for that: the lag of the positions is undone.

Source: Ljung, System Identification, 2nd edition, section 14.4 (prefiltering).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.errors import require
from data_converters.lag import without_lag
from data_converters.smoothing import (
    Array,
    CausalSmoother,
    Smoother,
    Unsmoothed,
    ZeroPhaseSmoother,
)
from data_converters.tracks import Sampling

SMOOTHERS = {each.__name__: each for each in (CausalSmoother, Unsmoothed, ZeroPhaseSmoother)}


class DrivenTrack(NamedTuple):
    """A track with recorded controls, one row per step."""

    position: Array  # (T, 2) m
    controls: Array  # (T, m), NaN where unknown
    bridged: NDArray[np.bool_]  # (T,), where no sample was near


def smoother_of(settings: Mapping[str, Any]) -> Smoother:
    """The smoother that `Smoother.settings` tells, as a cache holds them.

    Args:
        settings: Name, fields and look-ahead.

    Raises:
        ConversionError: No smoother has that name.
    """
    name = str(settings["name"])
    require(name in SMOOTHERS, "smoother", f"be one of {', '.join(SMOOTHERS)}", name, "", "")
    fields = {key: value for key, value in settings.items() if key not in ("name", "lookahead_s")}
    return SMOOTHERS[name](**fields)


def smoothed_beside(smoother: Smoother, values: Array, dt_s: float) -> Array:
    """Values (T, m) of equal steps as the smoother leaves them.

    Args:
        smoother: The one of the positions.
        values: (T, m), NaN where nothing was recorded.
        dt_s: Step in s.

    Returns:
        Of shape (T, m), each gap-free run by itself; NaN in gaps, in the warm-up of the smoother,
        and in runs that are too short for it.
    """
    result = np.full(values.shape, np.nan)
    known = np.isfinite(values).all(-1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    for first, last in edges.reshape(-1, 2):
        time_s = dt_s * np.arange(last - first)
        if last - first >= smoother.samples_needed:
            result[first:last] = smoother(time_s, values[first:last], time_s).value
    return result


def matched(smoother: Smoother, track: DrivenTrack, dt_s: float, sampling: Sampling) -> DrivenTrack:
    """A track whose controls and positions belong together.

    Args:
        smoother: What the positions went through.
        track: Smoothed positions, and controls as they were recorded.
        dt_s: Step of the track in s.
        sampling: When the track was sampled, which only the lag of a causal smoother depends on.

    Returns:
        Behind a causal smoother, positions without its lag; the controls are NaN where those are
        not certain: for the length of its window from the first row, and from gaps, on. Behind
        another one, controls through the same smoother.
    """
    if not isinstance(smoother, CausalSmoother):
        return track._replace(controls=smoothed_beside(smoother, track.controls, dt_s))
    after = track.bridged.copy()
    after[0] = True
    window = np.ones(ceil(smoother.window_s / dt_s - 1e-6))
    uncertain = np.convolve(after, window)[: len(after)] > 0
    return track._replace(
        position=without_lag(smoother, track.position, dt_s, sampling),
        controls=np.where(uncertain[:, None], np.nan, track.controls),
    )
