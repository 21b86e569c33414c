"""Pedestrian models behind one interface."""

from diffstack_mmv.simulation.pedestrians.base import Crowd, CrowdState, Itinerary, VisibleRobot
from diffstack_mmv.simulation.pedestrians.orca import OrcaCrowd
from diffstack_mmv.simulation.pedestrians.social_force import SocialForceCrowd
from diffstack_mmv.simulation.pedestrians.sudden import SuddenCrowd

__all__ = [
    "VisibleRobot",
    "Crowd",
    "CrowdState",
    "Itinerary",
    "OrcaCrowd",
    "SocialForceCrowd",
    "SuddenCrowd",
]
