"""Agreement of a model's lean with the measured one."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from diffstack_mmv.identification.inference.identification_problem import FittedMotion


def lean_agreement(
    rows: Sequence[FittedMotion], dt_s: float, longest_lag_s: float = 1.0
) -> Mapping[str, Any] | None:
    """Agreement of the model's lean with the measured one, which no fit uses.

    Args:
        rows: Segments with the motions fitted to them.
        dt_s: Step of the tracks.
        longest_lag_s: Largest lag of the model's lean that is tried.

    Returns:
        Root mean square difference in rad, correlation, number of samples; by how much the model's
        lean comes late (s) where it fits best, with the correlation there. Both correlations and
        the lag are None where one lean does not vary; all is None without a sample of both.
    """
    pairs = [
        (row.lean, row.segment.lean)
        for row in rows
        if row.lean is not None and row.segment.lean is not None
    ]
    if not pairs:
        return None
    model, measured = _overlapping(pairs, 0)
    if len(measured) == 0:
        return None
    lags = range(round(longest_lag_s / dt_s) + 1)
    by_lag = {lag: _correlation(*_overlapping(pairs, lag)) for lag in lags}
    known = {lag: found for lag, found in by_lag.items() if found is not None}
    best = max(known, key=known.__getitem__, default=None)
    return {
        "rms_difference_rad": float((model - measured).square().mean().sqrt()),
        "rms_measured_rad": float(measured.square().mean().sqrt()),
        "correlation": by_lag[0],
        "samples": len(measured),
        "late_s": None if best is None else best * dt_s,
        "correlation_late": None if best is None else known[best],
    }


def _overlapping(pairs: Sequence[tuple[Tensor, Tensor]], lag: int) -> tuple[Tensor, Tensor]:
    """All samples of the model, and of the measurement `lag` steps before, where there is one."""
    model = torch.cat([own[lag:] for own, _ in pairs])
    measured = torch.cat([other[: len(other) - lag] for _, other in pairs])
    known = measured.isfinite()
    return model[known], measured[known]


def _correlation(first: Tensor, second: Tensor) -> float | None:
    """None where one of both does not vary."""
    if len(first) < 2:
        return None
    found = float(torch.corrcoef(torch.stack([first, second]))[0, 1])
    return found if math.isfinite(found) else None
