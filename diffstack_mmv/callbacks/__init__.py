"""What a training run does beside training: records, tables and figures."""

from diffstack_mmv.callbacks.artifacts import CheckpointArtifact
from diffstack_mmv.callbacks.compilation import CompiledSolver
from diffstack_mmv.callbacks.dashboard import build_dashboard, dashboard
from diffstack_mmv.callbacks.monitors import GradientNorms, LearnedParameters, Throughput
from diffstack_mmv.callbacks.plans import PlanTable, scenes_of
from diffstack_mmv.callbacks.preemption import Preemption
from diffstack_mmv.callbacks.reproducibility import Provenance, RandomState, resume_point
from diffstack_mmv.callbacks.results import WandbResults

__all__ = [
    "CheckpointArtifact",
    "CompiledSolver",
    "GradientNorms",
    "LearnedParameters",
    "PlanTable",
    "Preemption",
    "Provenance",
    "RandomState",
    "Throughput",
    "WandbResults",
    "build_dashboard",
    "dashboard",
    "resume_point",
    "scenes_of",
]
