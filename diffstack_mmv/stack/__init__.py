"""The stack of prediction, planning and control, its training losses and its evaluation."""

from typing import TYPE_CHECKING

from dmmv_conventions.on_demand import on_demand

if TYPE_CHECKING:
    from diffstack_mmv.stack.checkpoint import (
        TrainedStack,
        learned_from,
        load_ensemble,
        load_predictor,
        load_stack,
        load_weights,
        read_checkpoint,
        start_from,
        write_lean,
    )
    from diffstack_mmv.stack.drawn_scenes import scene_records
    from diffstack_mmv.stack.evaluation import (
        Evaluation,
        Windows,
        evaluate_windows,
        fitted_calibration,
        outputs_of,
        representative,
    )
    from diffstack_mmv.stack.learning_rate import ScaledByProcesses
    from diffstack_mmv.stack.loss import LossWeights
    from diffstack_mmv.stack.module import DiffStackMMV, assemble
    from diffstack_mmv.stack.output import StackOutput
    from diffstack_mmv.stack.physics import PhysicsLearning
    from diffstack_mmv.stack.precision import MixedPrecision
    from diffstack_mmv.stack.processes import interrupts_raised, own_processes

__getattr__ = on_demand(__name__, __file__, "stack")
__all__ = [
    "DiffStackMMV",
    "Evaluation",
    "LossWeights",
    "MixedPrecision",
    "PhysicsLearning",
    "ScaledByProcesses",
    "StackOutput",
    "TrainedStack",
    "Windows",
    "assemble",
    "evaluate_windows",
    "fitted_calibration",
    "interrupts_raised",
    "learned_from",
    "load_ensemble",
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
