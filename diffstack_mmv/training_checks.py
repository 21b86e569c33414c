"""Checks of the settings of a training that Lightning or the optimizer would judge late or never.

They need neither: a mistake is told before what takes seconds is imported.
"""

from collections.abc import Mapping
from typing import Any

from diffstack_mmv.config_checks import require_share
from dmmv_conventions.checks import require_at_least, require_one_of

ACCELERATORS = ("auto", "cpu", "cuda", "gpu", "mps", "tpu")


def require_training(config: Mapping[str, Any]) -> None:
    """Refuse numbers of a training that are out of their range.

    Args:
        config: Configuration of the command `train`.

    Raises:
        ValueError: A number of epochs, a share of the batches, a limit of the gradient or a
            learning rate is impossible, or the accelerator has an unknown name.
    """
    validation, trainer = config["validation"], config["trainer"]
    require_at_least("epochs", config["epochs"], 0)
    require_at_least("validation.every_epochs", validation["every_epochs"], 1)
    require_share("validation.share", validation["share"])
    require_share("trainer.limit_train_batches", trainer["limit_train_batches"])
    require_at_least("trainer.log_every_n_steps", trainer["log_every_n_steps"], 1)
    if trainer["gradient_clip_val"] is not None:
        require_at_least("trainer.gradient_clip_val", trainer["gradient_clip_val"], 0.0)
    if isinstance(trainer["accelerator"], str):
        require_one_of("trainer.accelerator", trainer["accelerator"], ACCELERATORS)
    rate = config["optim"]["optimizer"].get("lr")
    if rate is not None:
        require_at_least("optim.optimizer.lr", rate, 0.0)
