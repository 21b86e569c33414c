"""Pedestrian models behind one interface."""

from diffstack_mmv.simulation.pedestrians.base import (
    Crowd,
    CrowdState,
    PedestrianHistory,
    VisibleRobot,
)
from diffstack_mmv.simulation.pedestrians.orca import OrcaCrowd
from diffstack_mmv.simulation.pedestrians.recorded import AnyCrowdState, RecordedCrowdState
from diffstack_mmv.simulation.pedestrians.replay import ReactiveReplayCrowd, ReplayCrowd
from diffstack_mmv.simulation.pedestrians.social_force import SocialForceCrowd

__all__ = [
    "AnyCrowdState",
    "Crowd",
    "CrowdState",
    "OrcaCrowd",
    "PedestrianHistory",
    "ReactiveReplayCrowd",
    "RecordedCrowdState",
    "ReplayCrowd",
    "SocialForceCrowd",
    "VisibleRobot",
]
