"""What a training run does beside training: records, tables and figures."""

from dmmv_conventions.extras import needs

with needs("stack", "diffstack_mmv.callbacks"):
    from diffstack_mmv.callbacks.artifacts import CheckpointArtifact
    from diffstack_mmv.callbacks.averaging import AveragedWeights
    from diffstack_mmv.callbacks.checkpoint_files import WholeCheckpoints
    from diffstack_mmv.callbacks.compilation import CompiledSolver
    from diffstack_mmv.callbacks.csv_log import KeptRows, ResumableCSVLogger
    from diffstack_mmv.callbacks.dashboard import build_dashboard, dashboard
    from diffstack_mmv.callbacks.monitors import (
        FiniteGradients,
        GradientNorms,
        LearnedParameters,
        Throughput,
        WallClock,
    )
    from diffstack_mmv.callbacks.plans import PlanTable, scenes_of
    from diffstack_mmv.callbacks.preemption import Preemption
    from diffstack_mmv.callbacks.reproducibility import (
        EarlyStopping,
        Provenance,
        RandomState,
        resume_point,
    )
    from diffstack_mmv.callbacks.results import WandbResults
    from diffstack_mmv.callbacks.wandb_log import QuietWandbLogger

__all__ = [
    "AveragedWeights",
    "CheckpointArtifact",
    "CompiledSolver",
    "EarlyStopping",
    "FiniteGradients",
    "GradientNorms",
    "KeptRows",
    "LearnedParameters",
    "PlanTable",
    "Preemption",
    "Provenance",
    "QuietWandbLogger",
    "RandomState",
    "ResumableCSVLogger",
    "Throughput",
    "WallClock",
    "WandbResults",
    "WholeCheckpoints",
    "build_dashboard",
    "dashboard",
    "resume_point",
    "scenes_of",
]
