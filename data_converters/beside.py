"""What was recorded beside a track, through the smoother of its positions.

A filter changes nothing in the relation between the input and the output of a linear system as long
as both pass through it. Positions that are smoothed beside controls that are not come later, or
turn less sharply, than those controls say.

Source: Ljung, System Identification, 2nd edition, section 14.4 (prefiltering).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from data_converters.errors import require
from data_converters.smoothing import (
    Array,
    CausalSmoother,
    Smoother,
    Unsmoothed,
    ZeroPhaseSmoother,
)

SMOOTHERS = {each.__name__: each for each in (CausalSmoother, Unsmoothed, ZeroPhaseSmoother)}


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
