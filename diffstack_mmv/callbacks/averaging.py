"""Averaged weights whose counts are those of the training."""

from typing import Any

import pytorch_lightning as pl
from pytorch_lightning.callbacks import EMAWeightAveraging


class AveragedWeights(EMAWeightAveraging):
    """Lightning's, which averages buffers of whole numbers, too: a count of steps would lag."""

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, *batch: Any
    ) -> None:
        """Average the weights after a step, and take over the counts."""
        super().on_train_batch_end(trainer, pl_module, *batch)
        averaged: Any = self._average_model
        for kept, count in zip(averaged.module.buffers(), pl_module.buffers(), strict=True):
            if not kept.is_floating_point():
                kept.copy_(count)
