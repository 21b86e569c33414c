"""What every score is called, measured in and judged by: the one place for titles and units."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

DIMENSIONLESS = "1"
"""Unit of a number or a share that has none."""


class Score(NamedTuple):
    """A score as files, logs, tables, dashboard and figures present it."""

    name: str  # key in files and logs
    title: str  # for people, without the unit
    unit: str  # DIMENSIONLESS for a number or a share
    lower_is_better: bool

    @property
    def heading(self) -> str:
        """Title with the unit in brackets, which a dimensionless number goes without."""
        return self.title if self.unit == DIMENSIONLESS else f"{self.title} [{self.unit}]"


def _by_name(*scores: Score) -> Mapping[str, Score]:
    """Registry of scores in the order of the tables."""
    return MappingProxyType({score.name: score for score in scores})


OPEN_LOOP = _by_name(
    Score("ade", "ADE", "m", True),
    Score("fde", "FDE", "m", True),
    Score("median_ade", "ADE of the median", "m", True),
    Score("median_fde", "FDE of the median", "m", True),
    Score("mean_ade", "ADE of the mean", "m", True),
    Score("mean_fde", "FDE of the mean", "m", True),
    Score("combined_ade", "ADE of the combined path", "m", True),
    Score("combined_fde", "FDE of the combined path", "m", True),
    Score("nll", "NLL", "nats", True),
    Score("plan_ade", "plan ADE", "m", True),
    Score("plan_fde", "plan FDE", "m", True),
    Score("planning_loss", "planning loss", DIMENSIONLESS, True),
    Score("planning_ce", "CE", "nats", True),
    Score("planning_cost", "cost", DIMENSIONLESS, True),
    Score("collision_rate", "collisions", DIMENSIONLESS, True),
    Score("human_collision_rate", "human's collisions", DIMENSIONLESS, True),
    Score("solved", "solved", DIMENSIONLESS, False),
    Score("min_ade", "minADE of five", "m", True),
    Score("miss_rate", "misses beyond 2 m", DIMENSIONLESS, True),
)
"""Scores of samples: predictions and plans beside what the human did.

`ade` and `fde` are those of the most likely path, `median_*` and `mean_*` those of the median and
the mean of the forecast, `combined_*` those of both and constant velocity (`combined_path`).
"""

OF_THE_PREDICTION = (
    "ade",
    "fde",
    "median_ade",
    "median_fde",
    "mean_ade",
    "mean_fde",
    "combined_ade",
    "combined_fde",
    "nll",
    "min_ade",
    "miss_rate",
)
"""Names of those of `OPEN_LOOP` that need no plan."""

CALIBRATION = _by_name(
    Score("coverage_50", "in the 50 % region", DIMENSIONLESS, False),
    Score("coverage_90", "in the 90 % region", DIMENSIONLESS, False),
    Score("area_50", "area of the 50 % region", "m²", True),
    Score("area_90", "area of the 90 % region", "m²", True),
)
"""Scores that only an evaluation computes, since they take samples.

The best coverages are 0.5 and 0.9; of two calibrated forecasts the sharper has smaller areas.
"""

SAMPLED = _by_name(
    Score("best_of_20_ade", "ADE best of 20", "m", True),
    Score("best_of_20_fde", "FDE best of 20", "m", True),
    Score("best_of_20_spread_ade", "ADE best of 20 spread", "m", True),
    Score("best_of_20_spread_fde", "FDE best of 20 spread", "m", True),
    Score("energy_score", "energy score", "m", True),
)
"""Scores of paths drawn from the prediction, see `best_of_samples` and `energy_score`."""

EVALUATED: Mapping[str, Score] = MappingProxyType({**OPEN_LOOP, **CALIBRATION, **SAMPLED})
"""Everything that an evaluation tells of a sample."""

PREDICTED: Mapping[str, Score] = MappingProxyType(
    {
        name: score
        for name, score in EVALUATED.items()
        if name in (*OF_THE_PREDICTION, *CALIBRATION, *SAMPLED)
    }
)
"""What an evaluation tells of a sample for which nothing is planned."""

CLOSED_LOOP = _by_name(
    Score("success_rate", "success", DIMENSIONLESS, False),
    Score("collision_rate", "collision", DIMENSIONLESS, True),
    Score("incomplete_rate", "incomplete", DIMENSIONLESS, True),
    Score("nav_time_s", "time", "s", True),
    Score("nav_time_all_s", "time of all", "s", True),
    Score("discomfort_frequency", "discomfort", DIMENSIONLESS, True),
    Score("avg_min_dist_m", "distance in discomfort", "m", False),
    Score("mean_episode_min_dist_m", "mean smallest distance", "m", False),
    Score("acceleration_mps2", "acceleration", "m/s²", True),
    Score("jerk_mps3", "jerk", "m/s³", True),
    Score("control_time_ms", "decision median / p99", "ms", True),
)
"""Scores of closed-loop episodes."""

DISPLACEMENT = Score("displacement", "mean distance to the human", "m", True)
"""The curve over the horizon whose mean over time is an ADE and whose last value an FDE.

Of a prediction it is that of the median of the forecast.
"""
