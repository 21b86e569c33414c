"""The stack of prediction, planning and control, its training losses and its evaluation."""

from dmmv_conventions.extras import needs

with needs("stack", "diffstack_mmv.stack"):
    from diffstack_mmv.stack.checkpoint import (
        TrainedStack,
        load_predictor,
        load_stack,
        load_weights,
        read_checkpoint,
        start_from,
        write_lean,
    )
    from diffstack_mmv.stack.evaluation import (
        Baseline,
        Evaluation,
        PathToGoal,
        PredictedPath,
        Windows,
        evaluate_windows,
        fitted_calibration,
        outputs_of,
        representative,
    )
    from diffstack_mmv.stack.learning_rate import ScaledByProcesses
    from diffstack_mmv.stack.module import DiffStackMMV, LossWeights, StackOutput, assemble
    from diffstack_mmv.stack.physics import PhysicsLearning
    from diffstack_mmv.stack.precision import MixedPrecision
    from diffstack_mmv.stack.processes import own_processes
    from diffstack_mmv.stack.scene_records import scene_records

__all__ = [
    "Baseline",
    "DiffStackMMV",
    "Evaluation",
    "LossWeights",
    "MixedPrecision",
    "PathToGoal",
    "PredictedPath",
    "PhysicsLearning",
    "ScaledByProcesses",
    "StackOutput",
    "TrainedStack",
    "Windows",
    "assemble",
    "evaluate_windows",
    "fitted_calibration",
    "load_predictor",
    "load_stack",
    "load_weights",
    "outputs_of",
    "own_processes",
    "read_checkpoint",
    "representative",
    "scene_records",
    "start_from",
    "write_lean",
]
