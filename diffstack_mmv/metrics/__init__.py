"""Metrics of predictions, plans and closed-loop episodes."""

from diffstack_mmv.metrics.by_mode import MeanByMode
from diffstack_mmv.metrics.displacement import (
    AverageDisplacement,
    FinalDisplacement,
    MinimumDisplacement,
    MissRate,
    average_displacement,
    best_average_displacement,
    final_displacement,
)
from diffstack_mmv.metrics.likelihood import NegativeLogLikelihood, negative_log_likelihood
from diffstack_mmv.metrics.planning import collides, overlap_now

__all__ = [
    "AverageDisplacement",
    "FinalDisplacement",
    "MeanByMode",
    "MinimumDisplacement",
    "MissRate",
    "NegativeLogLikelihood",
    "average_displacement",
    "best_average_displacement",
    "collides",
    "final_displacement",
    "negative_log_likelihood",
    "overlap_now",
]
