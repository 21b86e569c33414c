"""Training on machines that are taken away: saves where it stands, and ends."""

import logging
import os
import shutil
import signal
import subprocess
from pathlib import Path
from types import FrameType
from typing import Any

import pytorch_lightning as pl
from pytorch_lightning.callbacks import Checkpoint

LOGGER = logging.getLogger(__name__)


class Preemption(Checkpoint):
    """On SIGTERM or SIGUSR1, saves a checkpoint after the present batch and ends the training.

    The same command resumes there, within the epoch. A SLURM job that may be requeued (`sbatch
    --requeue`) asks for that itself. Batches whose gradients are added up
    (`trainer.accumulate_grad_batches`) count as one. A signal during the last batch or validation
    is answered after the first batch of the next epoch.

    Lightning asks what writes checkpoints last: averaged weights have then seen the batch.

    Args:
        path: The checkpoint, from which a training resumes.
        signals: Names of the signals.
    """

    def __init__(self, path: str, signals: tuple[str, ...] = ("SIGTERM", "SIGUSR1")) -> None:
        self.path = Path(path)
        self.signals = tuple(signal.Signals[name] for name in signals)
        self._received: signal.Signals | None = None
        self._process = os.getpid()
        self._before: dict[signal.Signals, Any] = {}

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Listen, in place of Lightning, which ends without a checkpoint."""
        self._received, self._process = None, os.getpid()
        self._before = {each: signal.signal(each, self._receive) for each in self.signals}

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, *batch: Any
    ) -> None:
        """Save and end, all processes together, if one of them was told to.

        Raises:
            InterruptedError: A signal came.
        """
        # behind its last batch an epoch still has its validation and its own checkpoint to come,
        # which a resumed run would leave out
        told = self._received is not None and not trainer.is_last_batch
        # nor does a checkpoint hold gradients that are only half added up
        told = told and (batch[-1] + 1) % trainer.accumulate_grad_batches == 0
        if not trainer.strategy.reduce_boolean_decision(told, all=False):
            return
        trainer.save_checkpoint(self.path, weights_only=False)
        if trainer.is_global_zero:
            _requeue()
        name = self._received.name if self._received else "a signal to another process"
        raise InterruptedError(
            f"Stopped by {name}; {self.path} is saved. Give the same command again, with the same "
            "`out`, to go on."
        )

    def teardown(self, trainer: pl.Trainer, pl_module: pl.LightningModule, stage: str) -> None:
        """Leave the signals as they were."""
        for each, handler in self._before.items():
            signal.signal(each, handler)
        self._before = {}

    def _receive(self, number: int, frame: FrameType | None) -> None:
        """Remember the signal; in a forked worker of a loader it has its usual effect."""
        if os.getpid() != self._process:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        self._received = signal.Signals(number)


def _requeue() -> None:
    """Put a SLURM job back into its queue."""
    job, tool = os.environ.get("SLURM_JOB_ID"), shutil.which("scontrol")
    if job is None or tool is None:
        return
    done = subprocess.run([tool, "requeue", job], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        LOGGER.warning("scontrol could not requeue job %s: %s", job, done.stderr.strip())
