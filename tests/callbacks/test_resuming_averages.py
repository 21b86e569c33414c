"""A training with averaged weights, validated every other epoch, goes on as if never stopped."""

import itertools
import logging
import os
import signal
import warnings
from pathlib import Path

import pytest
import pytorch_lightning as pl
import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf
from pytorch_lightning.callbacks import Callback
from torch.utils.data import DataLoader

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.vehicles import config_folder
from tests.callbacks.test_resuming import Killed, Line

pytestmark = pytest.mark.usefixtures("unchecked")

NEEDED = (
    *("checkpoint", "last", "early_stopping", "random_state", "rows", "wall_clock"),
    *("preemption", "ema"),
)


class Resumable(DataLoader):
    """Goes on behind the batch that was handed out last, as the loader of the windows does."""

    taken = start = 0

    def __iter__(self):
        self.taken, self.start = self.start, 0
        for batch in itertools.islice(super().__iter__(), self.taken, None):
            self.taken += 1
            yield batch
        self.taken = 0

    def state_dict(self):
        return {"taken": self.taken}

    def load_state_dict(self, state):
        self.start = state["taken"]


class Averaged(Line):
    """The line with that loader."""

    def train_dataloader(self):
        return Resumable(super().train_dataloader().dataset, 4, generator=torch.Generator())


class Told(Callback):
    """Sends a signal to the own process within a batch."""

    def __init__(self, epoch, batch):
        self.epoch, self.batch = epoch, batch

    def on_train_batch_start(self, trainer, module, batch, number):
        if (trainer.current_epoch, number) == (self.epoch, self.batch):
            os.kill(os.getpid(), signal.SIGTERM)


def callbacks_of(out):
    """Those of a training with `callbacks=ema`, in their order, but what looks into the stack."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        given = ["data.cache=none", f"out={out}", "callbacks=ema", "callbacks.ema.decay=0.5"]
        config = compose("train", given, return_hydra_config=True)
    HydraConfig.instance().set_config(config)
    callbacks = OmegaConf.to_container(config.callbacks, resolve=True)
    return [instantiate(each) for name, each in callbacks.items() if name in NEEDED]


def fit(out, extra=()):
    torch.manual_seed(3)
    last = Path(out) / "checkpoints" / "last.ckpt"
    trainer = pl.Trainer(
        accelerator="cpu",
        max_epochs=5,
        check_val_every_n_epoch=2,
        callbacks=[*extra, *callbacks_of(out)],
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        deterministic=True,
        default_root_dir=str(out),
    )
    trainer.fit(Averaged(), ckpt_path=last if last.is_file() else None, weights_only=True)


def stopped(out, extra):
    """Train in a process that is stopped on the way."""
    child = os.fork()
    if child == 0:
        try:
            fit(out, [extra])
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    assert status != 0
    assert (out / "checkpoints" / "last.ckpt").is_file()


def result(out):
    """Weights, averaged and as they are trained, and the state of all callbacks."""
    files = (out / "checkpoints" / f"{name}.ckpt" for name in ("best", "last"))
    read = [torch.load(file, weights_only=True) for file in files]
    names = ("state_dict", "current_model_state", "averaging_state", "global_step", "epoch")
    return [{name: each[name] for name in names if name in each} for each in read]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    logging.getLogger("pytorch_lightning").setLevel(logging.ERROR)
    warnings.simplefilter("ignore")
    out = tmp_path_factory.mktemp("whole")
    fit(out)
    return result(out)


@pytest.mark.parametrize(
    "stop",
    [
        Killed("on_train_epoch_start", 2),
        Killed("on_train_epoch_start", 3),
        Killed("on_train_batch_end", 2, 3),
        Killed("on_validation_batch_end", 3, 0),
        Told(1, 2),
        Told(2, 0),
        Told(3, 5),
    ],
    ids=lambda stop: f"{type(stop).__name__}-{stop.epoch}-{stop.batch}",
)
def test_averaged_weights_end_as_those_of_an_uninterrupted_run(stop, whole, tmp_path):
    stopped(tmp_path, stop)
    fit(tmp_path)
    for found, expected in zip(result(tmp_path), whole, strict=True):
        assert found.keys() == expected.keys() >= {"state_dict", "current_model_state"}
        torch.testing.assert_close(found, expected, rtol=0, atol=0)
