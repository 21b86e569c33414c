"""Checks of the settings of a training that Lightning or the optimizer would judge late or never.

They need neither: a mistake is told before what takes seconds is imported.
"""

import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

from diffstack_mmv.commands.config_checks import require_share
from diffstack_mmv.metrics import OF_THE_PREDICTION, OPEN_LOOP
from dmmv_conventions.checks import message, require, require_at_least, require_one_of
from dmmv_conventions.targets import nodes

ACCELERATORS = ("auto", "cpu", "cuda", "gpu", "mps", "tpu")
STRATEGIES = ("auto", "ddp", "deepspeed", "fsdp", "single", "xla")
"""Beginnings of the names of Lightning's strategies."""
CHOICES = {
    "gradient_clip_algorithm": ("norm", "value"),
    "profiler": ("advanced", "pytorch", "simple", "xla"),
}
"""What Lightning knows, of arguments that are any text for their annotation."""
PRECISIONS = ("32", "32-true", "64", "64-true")
LEAST = {
    **{"max_epochs": -1, "max_steps": -1, "num_sanity_val_steps": -1},
    **{"min_epochs": 0, "min_steps": 0, "reload_dataloaders_every_n_epochs": 0, "fast_dev_run": 0},
    **{"accumulate_grad_batches": 1, "check_val_every_n_epoch": 1, "num_nodes": 1},
    **{"log_every_n_steps": 1, "gradient_clip_val": 0.0},
}
SHARES = ("limit_train_batches", "limit_val_batches", "limit_test_batches", "limit_predict_batches")
OF_CALLBACKS = {
    **{"patience": 0, "save_top_k": -1, "every_n_train_steps": 0, "every_n_epochs": 0},
    **{"refresh_rate": 0, "update_every_n_steps": 1, "update_starting_at_step": 0},
}
UNWANTED = {
    "enable_checkpointing": "ModelCheckpoint",
    "enable_progress_bar": "ProgressBar",
    "enable_model_summary": "ModelSummary",
}
"""What Lightning refuses to switch off while a callback of the configuration does it."""
NOWHERE = {"Mirror": 0.5, "SpeedScale": 1.0}
"""Augmentations after which a sample is nowhere in the world, with their default probabilities."""
DURATION = re.compile(r"\d+:\d\d:\d\d:\d\d")


def require_training(config: Mapping[str, Any]) -> None:
    """Refuse values of a training that cannot be; their types have been judged before.

    Args:
        config: Configuration of the command `train`.

    Raises:
        ValueError: A number, a name or a combination that Lightning, one of its callbacks or the
            optimizer refuses, or a score to be watched that no validation logs.
    """
    validation, trainer = config["validation"], config["trainer"]
    callbacks = {name: each for name, each in config["callbacks"].items() if each is not None}
    require_at_least("epochs", config["epochs"], 0)
    require_at_least("validation.every_epochs", validation["every_epochs"], 1)
    require_share("validation.share", validation["share"])
    _require_devices(trainer)
    _require_limits(trainer)
    _require_names(trainer)
    _require_precision(trainer.get("precision"))
    _require_switches(trainer, callbacks)
    for name, callback in callbacks.items():
        _require_callback(f"callbacks.{name}", callback)
    _require_watched(config, callbacks)
    _require_optimizer(config["optim"]["optimizer"])
    _require_scheduler(config["optim"].get("scheduler"), config["epochs"])


def require_places(predictor: Mapping[str, Any], augmentation: Any) -> None:
    """Refuse a predictor that learns what places mean from samples none of which is at its place.

    Args:
        predictor: Configuration of the predictor.
        augmentation: Configuration of what changes its samples, plain containers.

    Raises:
        ValueError: An augmentation changes every sample so that it is nowhere in the world.
    """
    if predictor.get("site") is None:
        return
    for place, node in nodes(augmentation, "data.module.augmentation"):
        kind = str(node.get("_target_")).rpartition(".")[2] if isinstance(node, Mapping) else ""
        if kind in NOWHERE:
            share = node.get("probability", NOWHERE[kind])
            wanted = (
                "be below 1 beside a predictor with a site, which learns from the other samples"
            )
            key = re.sub(r"\[(\d+)\]", r".\1", place)  # as command lines name entries of a list
            remedy = f"Add ++{key}.probability=0.5, or take a predictor without a site."
            require(share < 1, f"{place}.probability", wanted, share, f"for {kind}", remedy)


def _require_limits(trainer: Mapping[str, Any]) -> None:
    """Refuse numbers of the trainer out of their range."""
    for name, least in LEAST.items():
        if trainer.get(name) is not None:
            require_at_least(f"trainer.{name}", trainer[name], least)
    for name in SHARES:
        if trainer.get(name) is not None:
            require_share(f"trainer.{name}", trainer[name])
    interval = trainer.get("val_check_interval")
    if isinstance(interval, int | float):
        require_share("trainer.val_check_interval", interval)
    for name in ("max_time", "val_check_interval"):
        given = trainer.get(name)
        known = not isinstance(given, str) or DURATION.fullmatch(given) is not None
        require(known, f"trainer.{name}", "be DAYS:HOURS:MINUTES:SECONDS, as 00:12:00:00", given)
    if trainer.get("overfit_batches"):
        require_share("trainer.overfit_batches", trainer["overfit_batches"])


def _require_names(trainer: Mapping[str, Any]) -> None:
    """Refuse names that Lightning does not know."""
    if isinstance(trainer["accelerator"], str):
        require_one_of("trainer.accelerator", trainer["accelerator"], ACCELERATORS)
    strategy = trainer.get("strategy")
    if isinstance(strategy, str):
        known = strategy.startswith(STRATEGIES)
        wanted = f"begin with one of {', '.join(STRATEGIES)}"
        require(known, "trainer.strategy", wanted, repr(strategy))
    for name, choices in CHOICES.items():
        if isinstance(trainer.get(name), str):
            require_one_of(f"trainer.{name}", trainer[name], choices)


def _require_precision(precision: object) -> None:
    """Refuse half precision of everything, in which covariances and dynamics lose their meaning."""
    whole = precision is None or str(precision) in PRECISIONS
    remedy = "Half precision where it does no harm is stack=mixed_precision."
    wanted = f"be one of {', '.join(PRECISIONS)}"
    require(whole, "trainer.precision", wanted, repr(precision), "", remedy)


def _require_switches(trainer: Mapping[str, Any], callbacks: Mapping[str, Any]) -> None:
    """Refuse what contradicts a callback, and a trainer that neither logs nor saves."""
    remedy = "A run is logged and saved here."
    require(not trainer.get("barebones"), "trainer.barebones", "be false", "true", "", remedy)
    for switch, kind in UNWANTED.items():
        doing = [name for name, each in callbacks.items() if each["_target_"].endswith(kind)]
        if trainer.get(switch) is False and doing:
            wanted = f"be true beside callbacks.{' and callbacks.'.join(doing)}"
            remedy = f"Add {' '.join(f'callbacks.{name}=null' for name in doing)}."
            raise ValueError(message(f"trainer.{switch}", wanted, "false", "", remedy))


def _require_callback(place: str, callback: Mapping[str, Any]) -> None:
    """Refuse values of a callback out of their range."""
    for name, least in OF_CALLBACKS.items():
        if callback.get(name) is not None:
            require_at_least(f"{place}.{name}", callback[name], least)
    monitors = callback["_target_"].endswith(("EarlyStopping", "ModelCheckpoint"))
    if monitors and callback.get("mode") is not None:
        require_one_of(f"{place}.mode", callback["mode"], ("max", "min"))
    several = callback.get("monitor") and callback.get("save_top_k") not in (None, 0, 1)
    if several and "{" not in str(callback.get("filename") or "{epoch}"):
        wanted = f"be 1 beside {place}.filename={callback['filename']}"
        remedy = "Give a filename with a field, as 'best-{epoch}': the last would replace the best."
        raise ValueError(message(f"{place}.save_top_k", wanted, callback["save_top_k"], "", remedy))
    if callback.get("every_n_train_steps") and callback.get("every_n_epochs"):
        wanted = f"be 0 beside {place}.every_n_train_steps"
        raise ValueError(message(f"{place}.every_n_epochs", wanted, callback["every_n_epochs"]))


def _require_watched(config: Mapping[str, Any], callbacks: Mapping[str, Any]) -> None:
    """Refuse a score that no validation logs: Lightning says so after the first epoch."""
    loss = config["loss"]
    plans = any(loss.get(name) != 0 for name in ("planning", "control"))
    known = tuple(OPEN_LOOP) if plans else OF_THE_PREDICTION
    watched = {"watched": config["watched"]}
    for name, callback in callbacks.items():
        if callback.get("monitor") not in (None, config["watched"]):
            watched[f"callbacks.{name}.monitor"] = callback["monitor"]
    for place, score in watched.items():
        kind, *mode, name = str(score).split("/") if "/" in score else ("val", score, "")
        if kind == "val":  # what is logged in training depends on more than the loss
            fits = name in known and all(each in config["modes"] for each in mode)
            wanted = f"be val/SCORE or val/MODE/SCORE with one of {', '.join(known)}"
            require(fits, place, wanted, repr(score), "", "A mode has to be one of `modes`.")


def _require_optimizer(optimizer: Mapping[str, Any]) -> None:
    """Refuse settings of the optimizer out of their range."""
    for name in ("lr", "eps", "weight_decay", "momentum"):
        if optimizer.get(name) is not None:
            require_at_least(f"optim.optimizer.{name}", optimizer[name], 0.0)
    for fading in optimizer.get("betas") or ():
        require(0.0 <= fading < 1.0, "optim.optimizer.betas", "lie in [0, 1)", fading)


def _require_scheduler(scheduler: Mapping[str, Any] | None, epochs: int) -> None:
    """Refuse intervals by which the learning rate cannot be divided; nothing learns in 0 epochs.

    A schedule is stepped after each epoch, also those without a validation.
    """
    kind = "" if scheduler is None else str(scheduler.get("_target_"))
    wanted, remedy = "need no monitored score", "Give another one, or optim.scheduler=null."
    needs_none = not kind.endswith(".ReduceLROnPlateau")
    require(needs_none, "optim.scheduler", wanted, kind, "", remedy)
    for name in ("T_max", "T_0", "step_size", "total_iters", "total_steps"):
        if scheduler is not None and scheduler.get(name) is not None and epochs > 0:
            require_at_least(f"optim.scheduler.{name}", scheduler[name], 1)


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
