"""DiffGM3: brush tyres, loads, steering, drive and lean for any layout of wheels."""

from diffstack_mmv.dynamics.gm3.lean import CoordinatedLean, PrescribedLean
from diffstack_mmv.dynamics.gm3.model import DiffGM3
from diffstack_mmv.dynamics.gm3.stepper import LIM2, ExplicitEuler, RungeKutta4
from diffstack_mmv.dynamics.gm3.tire import ConsistentBrush, PaperBrush, SharpBrush
from diffstack_mmv.dynamics.gm3.wheel_speed import DiffGM3WheelSpeed

__all__ = [
    "LIM2",
    "ConsistentBrush",
    "CoordinatedLean",
    "DiffGM3",
    "DiffGM3WheelSpeed",
    "ExplicitEuler",
    "PaperBrush",
    "PrescribedLean",
    "RungeKutta4",
    "SharpBrush",
]
