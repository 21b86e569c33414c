"""Train the stack end to end by imitation."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffstack_mmv.commands.cli import DictConfig, OmegaConf, command, instantiate
from diffstack_mmv.commands.config_checks import require_checkpoint
from diffstack_mmv.commands.data_checks import (
    require_data,
    require_own_vehicle,
    require_recordings,
    require_windows,
    told_of_data,
)
from diffstack_mmv.commands.training_checks import require_places, require_training
from diffstack_mmv.device_checks import require_accelerator
from dmmv_conventions.configs import config_folder
from dmmv_conventions.locks import is_first_process
from dmmv_conventions.pretrained import checkpoint_path

logger = logging.getLogger(__name__)

if TYPE_CHECKING:
    import pytorch_lightning as pl

    from diffstack_mmv.data import Recordings, TrajdataModule
    from diffstack_mmv.stack import DiffStackMMV


def check(config: DictConfig) -> None:
    """Refuse a run without recordings or with parts that cannot be built."""
    require_windows(
        config.modes, config.dt_s, history_s=config.history_s, horizon_s=config.horizon_s
    )
    require_training(config)
    module: Any = OmegaConf.to_container(config.data.module)
    require_places(config.predictor, module["augmentation"])
    require_own_vehicle(config.modes, config.vehicle, shared=config.shared_vehicle)
    require_data(config.data.module.windows, config.batch_size)
    require_recordings(config.data.module.source)
    if config.start is not None:
        require_checkpoint("start", config.start)
    require_accelerator(config.trainer.accelerator)
    # for their mistakes alone; they need torch, but nothing that takes longer to import
    learning = (config.loss, config.physics, config.optim.optimizer, config.stack.get("precision"))
    built = (config.dynamics, config.predictor, config.planner, config.goal)
    for part in (*told_of_data(config.data.module), *learning, *built):
        instantiate(part)


def resumed(config: DictConfig) -> Path | None:
    """Where the run in its folder goes on; a run of another configuration is refused."""
    from diffstack_mmv.callbacks import resume_point

    content: Any = OmegaConf.to_container(config)
    return resume_point(Path(config.out) / "checkpoints" / "last.ckpt", content)


@command(config_folder(), "train", check, admit=resumed)
def main(config: DictConfig) -> float | None:
    """Fit, and continue where an interrupted run of the same configuration stopped.

    Returns:
        The best value of the watched score, which a sweeper minimises.
    """
    import pytorch_lightning as pl

    from diffstack_mmv.callbacks import Provenance
    from diffstack_mmv.stack import interrupts_raised, learned_from, own_processes, start_from

    pl.seed_everything(config.seed, workers=True)
    content: Any = OmegaConf.to_container(config)
    resume = resumed(config)
    stack, data = instantiate(config.stack), instantiate(config.data.module)
    if config.start is not None and resume is None:
        start_from(stack, checkpoint_path(config.start), content)
    begun = resume or config.start
    lineage = partial(_lineage, learned_from(begun) if begun else {}, data, config.epochs)
    callbacks = [instantiate(each) for each in config.callbacks.values() if each is not None]
    loggers = [instantiate(each) for each in config.logger.values() if each is not None]
    trainer = instantiate(
        config.trainer, callbacks=[*callbacks, Provenance(content, lineage)], logger=loggers
    )
    checkpoints = Path(config.out) / "checkpoints"
    if config.epochs == 0:
        if resume is None:
            _save_as_it_is(trainer, stack, checkpoints)
        return None
    stack.require_learnable()  # before the windows are exported
    if is_first_process():
        # what is wrong with the data is told before there are others, which would fail over it
        data.prepare_splits([data.splits.train, data.splits.val])
    with own_processes(), interrupts_raised():
        for each in loggers:
            each.log_hyperparams(content)
        trainer.fit(stack, data, ckpt_path=resume)
    best = trainer.checkpoint_callback
    if trainer.is_global_zero:
        kept = Path(getattr(best, "best_model_path", "") or checkpoints / "last.ckpt")
        if kept.is_file():
            logger.info("Checkpoint: %s; scripts/evaluate.py checkpoint=%s scores it", kept, kept)
    score = getattr(best, "best_model_score", None)
    return None if score is None else float(score)


def _lineage(earlier: Recordings, data: TrajdataModule, epochs: int) -> Recordings:
    """Recordings of the training, and of those of before that it goes on from."""
    from diffstack_mmv.data import joined_recordings, recordings_of

    learned = recordings_of(data.samples(data.splits.train)) if epochs > 0 else {}
    return joined_recordings(earlier, learned)


def _save_as_it_is(trainer: pl.Trainer, stack: DiffStackMMV, folder: Path) -> None:
    """Write the checkpoints of a training that learns nothing, so that it can be evaluated."""
    trainer.strategy.connect(stack)
    for name in ("best", "last"):
        trainer.save_checkpoint(folder / f"{name}.ckpt", weights_only=False)


if __name__ == "__main__":
    main()
