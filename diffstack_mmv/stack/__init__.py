"""The stack of prediction, planning and control, its training losses and its evaluation."""

from diffstack_mmv.stack.evaluation import (
    Baseline,
    Evaluated,
    PathToGoal,
    PredictedPath,
    evaluate_batches,
)
from diffstack_mmv.stack.module import SCORES, DiffStackMMV, LossWeights, StackOutput, assemble

__all__ = [
    "SCORES",
    "Baseline",
    "DiffStackMMV",
    "Evaluated",
    "LossWeights",
    "PathToGoal",
    "PredictedPath",
    "StackOutput",
    "assemble",
    "evaluate_batches",
]
