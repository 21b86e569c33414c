"""Agreement of a model's lean with the measured one."""

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
        lean comes late (s) where it fits best, with the correlation there. None without both.
    """
    pairs = [
        (row.lean, row.segment.lean)
        for row in rows
        if row.lean is not None and row.segment.lean is not None
    ]
    if not pairs:
        return None
    model, measured = _overlapping(pairs, 0)
    lags = range(round(longest_lag_s / dt_s) + 1)
    by_lag = [float(_correlation(*_overlapping(pairs, lag))) for lag in lags]
    best = max(lags, key=by_lag.__getitem__)
    return {
        "rms_difference_rad": float((model - measured).square().mean().sqrt()),
        "rms_measured_rad": float(measured.square().mean().sqrt()),
        "correlation": by_lag[0],
        "samples": len(measured),
        "late_s": best * dt_s,
        "correlation_late": by_lag[best],
    }


def _overlapping(pairs: Sequence[tuple[Tensor, Tensor]], lag: int) -> tuple[Tensor, Tensor]:
    """All samples of the model, and of the measurement `lag` steps before, where there is one."""
    model = torch.cat([own[lag:] for own, _ in pairs])
    measured = torch.cat([other[: len(other) - lag] for _, other in pairs])
    known = measured.isfinite()
    return model[known], measured[known]


def _correlation(first: Tensor, second: Tensor) -> Tensor:
    return torch.corrcoef(torch.stack([first, second]))[0, 1]
