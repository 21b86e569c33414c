"""What is watched while training: learned parameters, gradients and throughput."""

import logging
import time
from typing import Any

import pytorch_lightning as pl
import torch
from pytorch_lightning.callbacks import Callback

from diffstack_mmv.checks import require, require_between

logger = logging.getLogger(__name__)


class LearnedParameters(Callback):
    """Logs the physical parameters in physical units and the cost weights after every epoch."""

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Log all values; a parameter per wheel gets one entry per wheel."""
        planner: Any = pl_module.planner
        values: dict[str, Any] = {
            f"cost_weight/{name}": weight for name, weight in planner.cost.weights().items()
        }
        for name, value in planner.dynamics.physical_parameters().items():
            flat = value.detach().reshape(-1)
            keys = (
                [f"physical/{name}"]
                if flat.numel() == 1
                else [f"physical/{name}/{wheel}" for wheel in range(flat.numel())]
            )
            values |= dict(zip(keys, flat, strict=True))
        pl_module.log_dict(
            {name: torch.as_tensor(value).detach() for name, value in values.items()}
        )


class GradientNorms(Callback):
    """Logs the norm of the gradient of each part of the stack, before it is clipped."""

    def on_before_optimizer_step(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        """Log one norm per part."""
        stack: Any = pl_module
        parts = {
            "predictor": stack.predictor,
            "cost": stack.planner.cost,
            "dynamics": stack.planner.dynamics,
        }
        for name, part in parts.items():
            norms = [p.grad.norm() for p in part.parameters() if p.grad is not None]
            if norms:
                pl_module.log(f"gradient/{name}", torch.stack(norms).norm())


class FiniteGradients(Callback):
    """Leaves out steps whose gradient is not finite, and stops a training that has many of them.

    One batch with an infinite slope would otherwise make all weights NaN for the rest of the run.
    Such a step has no gradient: with one of zero, momentum and decay would still move the weights.
    Each epoch tells how many there were.

    Args:
        at_most: Share of the steps of an epoch from which on the training stops.

    Raises:
        ValueError: `at_most` is not a share; in training: an epoch has more such steps.
    """

    def __init__(self, at_most: float = 0.1) -> None:
        require_between("at_most", at_most, 0.0, 1.0)
        self.at_most = at_most
        self._left_out = 0
        self._steps = 0

    def on_train_epoch_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Count anew."""
        self._left_out, self._steps = 0, 0

    def on_before_optimizer_step(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        """Drop the gradient if any part of it is not finite."""
        slopes = [p.grad for p in pl_module.parameters() if p.grad is not None]
        if not slopes:
            return
        sizes = torch.stack([slope.abs().amax() for slope in slopes if slope.numel() > 0])
        self._steps += 1
        if not bool(sizes.isfinite().all()):
            self._left_out += 1
            pl_module.zero_grad(set_to_none=True)

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Tell how many steps were left out, and stop if they were too many."""
        count, epoch = self._left_out, trainer.current_epoch
        pl_module.log("gradient/not_finite", float(count))
        if count == 0:
            return
        told = f"{count} of {self._steps} steps"
        require(
            count <= self.at_most * self._steps,
            "gradient",
            f"be finite in all but {100 * self.at_most:g} % of the steps of an epoch",
            f"one that is not in {told}",
            f"in epoch {epoch}",
            "Lower `optim.optimizer.lr`, or look for what is not finite in the data.",
        )
        logger.warning("Epoch %d: the gradient was not finite in %s, left out.", epoch, told)


class Throughput(Callback):
    """Logs the samples trained on per second, and the share of the time spent waiting for data."""

    def __init__(self) -> None:
        self._batch_start = 0.0
        self._batch_end = 0.0

    def on_train_epoch_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Start the clock."""
        self._batch_end = time.perf_counter()

    def on_train_batch_start(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        """Mark when the batch had arrived."""
        self._batch_start = time.perf_counter()

    def on_train_batch_end(
        self,
        trainer: pl.Trainer,
        pl_module: pl.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Log the rate of this batch, per process."""
        now = time.perf_counter()
        elapsed_s = now - self._batch_end
        waited_s = self._batch_start - self._batch_end
        self._batch_end = now
        pl_module.log("throughput/samples_per_s", len(batch.goal) / elapsed_s)
        pl_module.log("throughput/waiting_share", waited_s / elapsed_s)


class WallClock(Callback):
    """Logs the time spent on training in s; a resumed run goes on where its checkpoint was."""

    def __init__(self) -> None:
        self._before_s = 0.0
        self._start = time.perf_counter()

    def state_dict(self) -> dict[str, float]:
        """Time spent so far in s."""
        return {"elapsed_s": self._elapsed_s()}

    def load_state_dict(self, state_dict: dict[str, float]) -> None:
        """Go on counting from there."""
        self._before_s = state_dict["elapsed_s"]

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Start the clock."""
        self._start = time.perf_counter()

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Log the time since the run first started."""
        pl_module.log("throughput/elapsed_s", self._elapsed_s())

    def _elapsed_s(self) -> float:
        return self._before_s + time.perf_counter() - self._start
