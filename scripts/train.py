"""Train the stack end to end by imitation."""

from pathlib import Path
from typing import Any

import pytorch_lightning as pl
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from diffstack_mmv.callbacks import Provenance, resume_point
from diffstack_mmv.cli import command
from diffstack_mmv.stack import start_from
from diffstack_mmv.vehicles import config_folder


def resumed(config: DictConfig) -> Path | None:
    """Where the run in its folder goes on; a run of another configuration is refused."""
    content: Any = OmegaConf.to_container(config)
    return resume_point(Path(config.out) / "checkpoints" / "last.ckpt", content)


@command(config_folder(), "train", admit=resumed)
def main(config: DictConfig) -> None:
    """Fit, and continue where an interrupted run of the same configuration stopped."""
    pl.seed_everything(config.seed, workers=True)
    content: Any = OmegaConf.to_container(config)
    resume = resumed(config)
    stack, data = instantiate(config.stack), instantiate(config.data.module)
    if config.start is not None and resume is None:
        start_from(stack, Path(config.start))
    callbacks = [instantiate(each) for each in config.callbacks.values() if each is not None]
    loggers = [instantiate(each) for each in config.logger.values() if each is not None]
    trainer = instantiate(
        config.trainer, callbacks=[*callbacks, Provenance(content)], logger=loggers
    )
    trainer.fit(stack, data, ckpt_path=resume)


if __name__ == "__main__":
    main()
