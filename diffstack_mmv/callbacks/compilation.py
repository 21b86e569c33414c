"""Compiles the stack where a training is long enough to win the time back."""

from typing import Any

import pytorch_lightning as pl
from pytorch_lightning.callbacks import Callback

from diffstack_mmv.checks import require_at_least


class CompiledSolver(Callback):
    """Has the stack compiled if the training takes many steps; a short one runs eagerly.

    The choice depends on the number of steps alone, so that a run can be repeated to the digit, and
    not on what the configuration says of the solver, which a checkpoint hands on to evaluations of
    a few windows.

    Args:
        steps: Steps of the optimiser from which on compiling pays: ten seconds for DiffKBM are
            won back in ten steps of 64 windows, 75 for DiffGM3 in as many.

    Raises:
        ValueError: The number is negative.
    """

    def __init__(self, steps: int = 50) -> None:
        require_at_least("steps", steps, 0)
        self.steps = steps

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Compile, if it pays and there is a compiler."""
        stack: Any = pl_module
        if trainer.estimated_stepping_batches >= self.steps:
            stack.compile_kernels()
