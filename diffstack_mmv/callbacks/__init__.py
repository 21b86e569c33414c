"""What a training run does beside training: records, tables and figures."""

from diffstack_mmv.callbacks.compilation import CompiledSolver
from diffstack_mmv.callbacks.csv_log import KeptRows, ResumableCSVLogger
from diffstack_mmv.callbacks.dashboard import build_dashboard
from diffstack_mmv.callbacks.monitors import GradientNorms, LearnedParameters, Throughput, WallClock
from diffstack_mmv.callbacks.plans import PlanTable, scenes_of
from diffstack_mmv.callbacks.reproducibility import (
    EarlyStopping,
    Provenance,
    RandomState,
    resume_point,
)

__all__ = [
    "CompiledSolver",
    "EarlyStopping",
    "GradientNorms",
    "KeptRows",
    "LearnedParameters",
    "PlanTable",
    "Provenance",
    "RandomState",
    "ResumableCSVLogger",
    "Throughput",
    "WallClock",
    "build_dashboard",
    "resume_point",
    "scenes_of",
]
