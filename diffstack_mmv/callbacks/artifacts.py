"""Checkpoints among the artifacts of a W&B run."""

from pathlib import Path
from typing import Any

import pytorch_lightning as pl
import wandb
from pytorch_lightning.callbacks import Callback
from pytorch_lightning.loggers import WandbLogger
from pytorch_lightning.utilities import rank_zero_only


class CheckpointArtifact(Callback):
    """Adds the checkpoints at the end of a training, also to an offline run.

    Lightning's own `log_model` refuses offline runs. The files are not copied: `wandb sync` reads
    them where they are.

    Args:
        folder: Folder of the checkpoints.
        names: Files in it, each of which becomes a version of an artifact under its own alias.
    """

    def __init__(self, folder: str, names: tuple[str, ...] = ("best.ckpt", "last.ckpt")) -> None:
        self.folder = Path(folder)
        self.names = tuple(names)

    @rank_zero_only
    def on_fit_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Add what is there."""
        logger = next((each for each in trainer.loggers if isinstance(each, WandbLogger)), None)
        if logger is None:
            return
        run: Any = logger.experiment
        for file in (self.folder / name for name in self.names):
            if file.is_file():
                artifact = wandb.Artifact(f"checkpoint-{run.id}", "model")
                artifact.add_file(str(file), policy="immutable", skip_cache=True)
                run.log_artifact(artifact, aliases=[file.stem])
