"""Metrics of predictions, plans and closed-loop episodes."""

from diffstack_mmv.metrics.by_mode import MeanByMode
from diffstack_mmv.metrics.planning import collides, overlap_now

__all__ = ["MeanByMode", "collides", "overlap_now"]
