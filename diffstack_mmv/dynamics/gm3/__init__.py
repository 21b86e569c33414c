"""DiffGM3: brush tyres, loads, steering, drive and lean for any layout of wheels."""

from diffstack_mmv.dynamics.gm3.model import DiffGM3
from diffstack_mmv.dynamics.gm3.stepper import LIM2, ExplicitEuler, RungeKutta4
from diffstack_mmv.dynamics.gm3.tire import ConsistentBrush, PaperBrush, SharpBrush

__all__ = [
    "LIM2",
    "ConsistentBrush",
    "DiffGM3",
    "ExplicitEuler",
    "PaperBrush",
    "RungeKutta4",
    "SharpBrush",
]
