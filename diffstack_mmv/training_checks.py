"""Checks of the settings of a training that Lightning or the optimizer would judge late or never.

They need neither: a mistake is told before what takes seconds is imported.
"""

import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

from diffstack_mmv.config_checks import require_share
from dmmv_conventions.checks import require, require_at_least, require_one_of

ACCELERATORS = ("auto", "cpu", "cuda", "gpu", "mps", "tpu")
STRATEGIES = ("auto", "ddp", "deepspeed", "fsdp", "single", "xla")
"""Beginnings of the names of Lightning's strategies."""
PRECISIONS = (
    *("64-true", "64", "32-true", "32", "16-true", "16-mixed", "16"),
    *("bf16-true", "bf16-mixed", "bf16", "transformer-engine", "transformer-engine-float16"),
)


def require_training(config: Mapping[str, Any]) -> None:
    """Refuse numbers of a training that are out of their range.

    Args:
        config: Configuration of the command `train`.

    Raises:
        ValueError: A number of epochs, steps or devices, a share of the batches, a limit of the
            gradient or a learning rate is impossible, or accelerator, strategy or precision has an
            unknown name.
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
    _require_devices(trainer)
    for name, least in (("num_nodes", 1), ("max_steps", -1), ("num_sanity_val_steps", -1)):
        number = trainer.get(name)
        if number is not None:
            require(isinstance(number, int), f"trainer.{name}", "be a whole number", repr(number))
            require_at_least(f"trainer.{name}", number, least)
    strategy = trainer.get("strategy")
    if isinstance(strategy, str):
        known = strategy.startswith(STRATEGIES)
        wanted = f"begin with one of {', '.join(STRATEGIES)}"
        require(known, "trainer.strategy", wanted, repr(strategy))
    precision = trainer.get("precision")
    if precision is not None:
        require_one_of("trainer.precision", str(precision), PRECISIONS)
    rate = config["optim"]["optimizer"].get("lr")
    if rate is not None:
        require_at_least("optim.optimizer.lr", rate, 0.0)


def _require_devices(trainer: Mapping[str, Any]) -> None:
    """Refuse a number of devices that there cannot be; processes share the cores of a CPU."""
    devices = trainer["devices"]
    several = isinstance(devices, Sequence) and not isinstance(devices, str)
    if several or devices in ("auto", "-1", -1):
        return
    known = re.fullmatch(r"0*[1-9]\d*|\d+(,\d+)+", str(devices)) is not None
    wanted = "be a number of devices, a list of them, or auto"
    remedy = "Write trainer.devices=1, or trainer.devices=[0,1] for the first two."
    require(known, "trainer.devices", wanted, repr(devices), "", remedy)
    cores = os.cpu_count() or 1
    if trainer["accelerator"] == "cpu" and isinstance(devices, int):
        wanted = f"be at most {cores}, the number of cores"
        require(devices <= cores, "trainer.devices", wanted, devices)
