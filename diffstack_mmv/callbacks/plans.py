"""A table of sample plans with images in the run's dashboard."""

from typing import Any

import numpy as np
import pytorch_lightning as pl
import torch
import wandb
from pytorch_lightning.callbacks import Callback
from pytorch_lightning.loggers import WandbLogger
from pytorch_lightning.utilities import rank_zero_only

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.metrics import OPEN_LOOP
from diffstack_mmv.plotting import PlannedScene, draw_scenes
from diffstack_mmv.types import Mode, StackBatch, Tracks, map_tensors

SHOWN = ("median_ade", "plan_ade")
"""Scores beside each image, by name."""


def scenes_of(
    batch: StackBatch, output: Any, titles: list[str], shown_components: int = 8
) -> list[PlannedScene]:
    """What a stack made of a batch, ready to draw; positions in m."""
    own = map_tensors(lambda field: field[:, 0], output.forecast)  # that of the ego
    order = own.log_weight.argsort(-1, descending=True)[:, :shown_components]
    mean = own.mean.take_along_dim(order[:, :, None, None], 1)
    weight = own.log_weight.take_along_dim(order, 1).exp()
    neighbors = _paths(batch.neighbors_future)
    present = batch.neighbors_past.valid[..., -1]
    columns = (
        batch.ego_past.motion.position,
        batch.ego_future.motion.position,
        output.plan.motion.position,
        own.median(),
        mean,
        weight,
        output.goal,
        output.plan.candidates.position,
    )
    arrays: list[np.ndarray] = [column.detach().cpu().numpy() for column in columns]
    seen = present.cpu().numpy()
    return [
        PlannedScene._make([title, *(array[i] for array in arrays), neighbors[i][seen[i]]])
        for i, title in enumerate(titles)
    ]


def _paths(tracks: Tracks) -> np.ndarray:
    position = tracks.motion.position.masked_fill(~tracks.valid.unsqueeze(-1), float("nan"))
    return position.detach().cpu().numpy()


class PlanTable(Callback):
    """Logs the plans of the first validation samples as a W&B table with one image each.

    Args:
        samples: How many samples.
        every_epochs: After how many epochs.

    Raises:
        ValueError: A number is below one.
    """

    def __init__(self, samples: int = 6, every_epochs: int = 5) -> None:
        require_at_least("samples", samples, 1)
        require_at_least("every_epochs", every_epochs, 1)
        self.samples = samples
        self.every_epochs = every_epochs

    @rank_zero_only
    def on_validation_batch_end(
        self,
        trainer: pl.Trainer,
        pl_module: pl.LightningModule,
        outputs: Any,
        batch: StackBatch,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Draw and log, on the first batch of an epoch whose turn it is.

        Of a stack whose loss plans nothing, no plan is made for a picture either.
        """
        logger = next((each for each in trainer.loggers if isinstance(each, WandbLogger)), None)
        its_turn = trainer.current_epoch % self.every_epochs == 0 and not trainer.sanity_checking
        stack: Any = pl_module
        if batch_idx > 0 or logger is None or not its_turn or not stack.loss_weights.plans:
            return
        batch = map_tensors(lambda tensor: tensor[: self.samples], batch)
        with torch.no_grad():
            output = stack(batch)
            scores = stack.score(batch, output)
        labels = [Mode(mode).label for mode in batch.ego_past.mode.tolist()]
        headings = [OPEN_LOOP[name].heading for name in SHOWN]
        table = wandb.Table(columns=["mode", *headings, "plan"])
        for i, scene in enumerate(scenes_of(batch, output, labels)):
            figure = draw_scenes([scene], columns=1)
            image = wandb.Image(_pixels(figure))
            table.add_data(labels[i], *(float(scores[name][i]) for name in SHOWN), image)
        logger.experiment.log({"plans": table, "epoch": trainer.current_epoch})


def _pixels(figure: Any) -> np.ndarray:
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())
