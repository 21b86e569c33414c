"""Intervals of means over samples that resemble each other within a recording."""

import numpy as np
import pandas as pd

LEVEL = 95.0
FEWEST_RECORDINGS = 8
"""With fewer recordings the interval holds the mean far less often than it says (four: 78 %)."""


def bootstrap(
    values: pd.Series, recordings: pd.Series, resamples: int = 1000, seed: int = 0
) -> tuple[float, float]:
    """Interval of 95 % of the mean over samples when recordings are drawn with replacement.

    Args:
        values: One per sample, NaN where there is none.
        recordings: Of which recording each sample is.
        resamples: Number of draws.
        seed: Of the draws.

    Returns:
        Low and high; NaN with less than `FEWEST_RECORDINGS`.
    """
    parts = pd.DataFrame({"value": values, "recording": recordings}).dropna()
    grouped = parts.groupby("recording")["value"].agg(["sum", "count"]).to_numpy()
    if len(grouped) < FEWEST_RECORDINGS:
        return float("nan"), float("nan")
    draws = np.random.default_rng(seed).integers(0, len(grouped), (resamples, len(grouped)))
    totals = grouped[draws].sum(1)
    low, high = np.percentile(totals[:, 0] / totals[:, 1], [50 - LEVEL / 2, 50 + LEVEL / 2])
    return float(low), float(high)
