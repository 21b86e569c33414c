"""Cost weights tuned by what driving with them comes to."""

from diffstack_mmv.simulation.tuning.loss import DrivingLoss
from diffstack_mmv.simulation.tuning.tuners import GradientTuner, OptunaTuner, Round, best

__all__ = ["DrivingLoss", "GradientTuner", "OptunaTuner", "Round", "best"]
