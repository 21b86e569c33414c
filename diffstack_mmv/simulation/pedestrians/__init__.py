"""Pedestrian models behind one interface."""

from diffstack_mmv.simulation.pedestrians.base import Bystander, Crowd, CrowdState
from diffstack_mmv.simulation.pedestrians.orca import OrcaCrowd
from diffstack_mmv.simulation.pedestrians.social_force import SocialForceCrowd

__all__ = ["Bystander", "Crowd", "CrowdState", "OrcaCrowd", "SocialForceCrowd"]
