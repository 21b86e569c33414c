"""Pedestrian models behind one interface."""

from diffstack_mmv.simulation.pedestrians.base import Crowd, CrowdState, VisibleRobot
from diffstack_mmv.simulation.pedestrians.orca import OrcaCrowd
from diffstack_mmv.simulation.pedestrians.social_force import SocialForceCrowd

__all__ = ["VisibleRobot", "Crowd", "CrowdState", "OrcaCrowd", "SocialForceCrowd"]
