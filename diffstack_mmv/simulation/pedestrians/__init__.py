"""Pedestrian models behind one interface."""

from diffstack_mmv.simulation.pedestrians.abrupt import AbruptCrowd
from diffstack_mmv.simulation.pedestrians.base import (
    Crowd,
    CrowdState,
    Itinerary,
    PedestrianHistory,
    VisibleRobot,
)
from diffstack_mmv.simulation.pedestrians.orca import OrcaCrowd
from diffstack_mmv.simulation.pedestrians.recorded import AnyCrowdState, RecordedCrowdState
from diffstack_mmv.simulation.pedestrians.replay import ReactiveReplayCrowd, ReplayCrowd
from diffstack_mmv.simulation.pedestrians.social_force import SocialForceCrowd
from diffstack_mmv.simulation.pedestrians.sudden import SuddenCrowd

__all__ = [
    "AbruptCrowd",
    "AnyCrowdState",
    "Crowd",
    "CrowdState",
    "Itinerary",
    "OrcaCrowd",
    "PedestrianHistory",
    "ReactiveReplayCrowd",
    "RecordedCrowdState",
    "ReplayCrowd",
    "SocialForceCrowd",
    "SuddenCrowd",
    "VisibleRobot",
]
