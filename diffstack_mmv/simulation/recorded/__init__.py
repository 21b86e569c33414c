"""Recorded crowds: a vehicle crosses the way of agents as they were recorded."""

from diffstack_mmv.simulation.recorded.crossing import CrossingRules
from diffstack_mmv.simulation.recorded.foresight import KnownFuture
from diffstack_mmv.simulation.recorded.passage import PassageRules
from diffstack_mmv.simulation.recorded.scenario import RecordedCrossing, SceneReader

__all__ = ["CrossingRules", "KnownFuture", "PassageRules", "RecordedCrossing", "SceneReader"]
