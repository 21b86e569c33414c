"""Pedestrian models behind one interface."""

from diffstack_mmv.simulation.pedestrians.base import Bystander, Crowd, CrowdState
from diffstack_mmv.simulation.pedestrians.orca import OrcaCrowd

__all__ = ["Bystander", "Crowd", "CrowdState", "OrcaCrowd"]
