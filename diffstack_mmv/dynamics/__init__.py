"""Vehicle dynamics: one class per model behind one interface."""

from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.gm3.model import DiffGM3
from diffstack_mmv.dynamics.holonomic import Holonomic
from diffstack_mmv.dynamics.kbm import DiffKBM, ReversingFloor, SoftplusFloor
from diffstack_mmv.dynamics.records import (
    AccelerationRange,
    DerivedQuantity,
    DriverInput,
    WheelForces,
)
from diffstack_mmv.dynamics.rollout import rollout
from diffstack_mmv.dynamics.single_integrator import SingleIntegrator
from diffstack_mmv.dynamics.unicycle import ExtendedUnicycle

__all__ = [
    "AccelerationRange",
    "DerivedQuantity",
    "DiffGM3",
    "DiffKBM",
    "DriverInput",
    "DynamicsModel",
    "ExtendedUnicycle",
    "Holonomic",
    "ReversingFloor",
    "SingleIntegrator",
    "SoftplusFloor",
    "WheelForces",
    "rollout",
]
