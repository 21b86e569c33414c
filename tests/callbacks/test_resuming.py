"""A training that is killed anywhere and started again ends as if nothing had happened."""

import logging
import os
import signal
import warnings
from pathlib import Path

import pandas as pd
import pytest
import pytorch_lightning as pl
import torch
from hydra.utils import instantiate
from lightning_fabric.plugins.io import torch_io
from lightning_fabric.utilities import cloud_io
from omegaconf import OmegaConf
from pytorch_lightning.callbacks import Callback
from torch.utils.data import DataLoader, TensorDataset

from diffstack_mmv.callbacks import Provenance, ResumableCSVLogger
from diffstack_mmv.vehicles import config_folder

pytestmark = pytest.mark.usefixtures("unchecked")

STEPS = 6
# what a clock says differs from run to run
CLOCKS = ["throughput/elapsed_s"]


class Line(pl.LightningModule):
    """Fits a line with noisy inputs, so that random numbers matter."""

    def __init__(self):
        super().__init__()
        self.line = torch.nn.Linear(2, 1)

    def training_step(self, batch, number):
        x, y = batch
        loss = (self.line(x + 0.1 * torch.randn_like(x)) - y).square().mean()
        self.log("train/loss", loss, on_step=True, on_epoch=True)
        return loss

    def validation_step(self, batch, number):
        x, y = batch
        self.log("val/error", (self.line(x) - y).abs().mean())
        # a score that gets worse from the third epoch on, so that the training stops early
        self.log("val/plan_ade", torch.tensor(abs(self.current_epoch - 1.5)))

    def configure_optimizers(self):
        return torch.optim.Adam(self.parameters(), 0.05)

    def train_dataloader(self):
        x = torch.randn(4 * STEPS, 2, generator=torch.Generator().manual_seed(1))
        windows = TensorDataset(x, x.sum(1, keepdim=True))
        return DataLoader(windows, 4, generator=torch.Generator())

    def val_dataloader(self):
        return DataLoader(TensorDataset(torch.ones(8, 2), torch.ones(8, 1)), 4)


class Killed(Callback):
    """Kills the process at a hook, as a power cut would: nothing is flushed or cleaned up."""

    def __init__(self, hook, epoch, batch=None):
        setattr(self, hook, self._kill)
        self.epoch, self.batch = epoch, batch

    def _kill(self, trainer, module, *arguments):
        reached = self.batch is None or self.batch in arguments
        if trainer.current_epoch == self.epoch and reached:
            os.kill(os.getpid(), signal.SIGKILL)


def callbacks_of(out):
    """What a run has by default, without what looks into the stack."""
    content = OmegaConf.load(config_folder() / "callbacks" / "default.yaml")
    whole = OmegaConf.create({"out": str(out), "watched": "val/plan_ade", "callbacks": content})
    names = ("checkpoint", "last", "early_stopping", "random_state", "rows", "wall_clock")
    whole.callbacks.early_stopping.patience = 2
    return [instantiate(whole.callbacks[name]) for name in names]


def fit(out, extra=(), epochs=6):
    torch.manual_seed(3)
    last = Path(out) / "checkpoints" / "last.ckpt"
    trainer = pl.Trainer(
        accelerator="cpu",
        max_epochs=epochs,
        callbacks=[*callbacks_of(out), *extra],
        logger=ResumableCSVLogger(str(out), name="csv", version=""),
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        log_every_n_steps=2,
        deterministic=True,
        default_root_dir=str(out),
    )
    trainer.fit(Line(), ckpt_path=last if last.is_file() else None, weights_only=True)
    return trainer


def killed(out, prepare=lambda: None, extra=()):
    """Train in a process that dies on the way."""
    child = os.fork()
    if child == 0:
        prepare()
        fit(out, extra)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "the training was to be killed"


def result(out):
    """Table, weights, best score and the state of early stopping of a run."""
    table = pd.read_csv(out / "csv" / "metrics.csv")
    names = ("best", "last")
    files = [torch.load(out / "checkpoints" / f"{n}.ckpt", weights_only=True) for n in names]
    states = files[1]["callbacks"]
    (best,) = (
        states[name] for name in states if name.startswith("ModelCheckpoint{'monitor': 'val")
    )
    stopping = states["EarlyStopping{'monitor': 'val/plan_ade', 'mode': 'min'}"]
    told = {
        "steps": [file["global_step"] for file in files],
        "best": float(best["best_model_score"]),
        "stopping": [stopping["wait_count"], stopping["stopped_epoch"], stopping["best_score"]],
    }
    return table, [file["state_dict"] for file in files], told


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    logging.getLogger("pytorch_lightning").setLevel(logging.ERROR)
    warnings.simplefilter("ignore")
    out = tmp_path_factory.mktemp("whole")
    fit(out)
    return result(out)


def die(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)


def in_a_write(number, share):
    """Die when the checkpoint of that number is written, a share of it being on the disk."""

    def prepare():
        count, write = iter(range(1, 99)), cloud_io._atomic_save

        def save(checkpoint, path):
            if next(count) == number:
                torch.save(checkpoint, f"{path}.whole")
                content = Path(f"{path}.whole").read_bytes()
                Path(f"{path}.part").write_bytes(content[: int(share * len(content))])
                die()
            write(checkpoint, path)

        for module in (cloud_io, torch_io):
            module._atomic_save = save

    return prepare


KILLS = {
    "in an epoch": {"extra": [Killed("on_train_batch_end", 2, 3)]},
    "in the first epoch": {"extra": [Killed("on_train_batch_end", 0, 3)]},
    "in validation": {"extra": [Killed("on_validation_batch_end", 2, 0)]},
    "behind an epoch": {"extra": [Killed("on_train_epoch_start", 2)]},
    "while best is written": {"prepare": in_a_write(3, 0.5)},
    "between best and last": {"prepare": in_a_write(4, 0.0)},
    "before the first last": {"prepare": in_a_write(2, 0.9)},
    "while last of an epoch that improved nothing is written": {"prepare": in_a_write(5, 0.5)},
    "in the epoch that stops": {"extra": [Killed("on_train_batch_end", 3, 0)]},
}


@pytest.mark.parametrize("kill", KILLS)
def test_a_killed_run_ends_as_the_uninterrupted_one(kill, whole, tmp_path):
    killed(tmp_path, **KILLS[kill])
    fit(tmp_path)
    table, weights, told = result(tmp_path)
    pd.testing.assert_frame_equal(table.drop(columns=CLOCKS), whole[0].drop(columns=CLOCKS))
    for found, expected in zip(weights, whole[1], strict=True):
        assert all(torch.equal(found[name], expected[name]) for name in expected)
    assert told == whole[2]
    assert table[CLOCKS[0]].dropna().is_monotonic_increasing


def test_a_run_whose_folder_was_moved_keeps_its_best_checkpoint(whole, tmp_path):
    fit(tmp_path / "before", extra=[Provenance({})], epochs=2)
    (tmp_path / "before").rename(tmp_path / "now")
    trainer = fit(tmp_path / "now", extra=[Provenance({})])
    _, weights, told = result(tmp_path / "now")
    assert told == whole[2]
    assert all(torch.equal(weights[0][name], whole[1][0][name]) for name in weights[0])
    best = tmp_path / "now" / "checkpoints" / "best.ckpt"
    assert trainer.checkpoint_callback.best_model_path == str(best)
    assert not (tmp_path / "before").exists()


def test_a_run_that_stopped_early_stays_stopped(tmp_path):
    first = fit(tmp_path)
    before = result(tmp_path)
    again = fit(tmp_path)
    assert first.current_epoch == again.current_epoch < 6
    pd.testing.assert_frame_equal(result(tmp_path)[0], before[0])


def test_a_row_that_was_cut_off_is_left_out_and_written_again(whole, tmp_path):
    fit(tmp_path, epochs=2)
    table = tmp_path / "csv" / "metrics.csv"
    table.write_text(table.read_text() + "2,1")
    fit(tmp_path, epochs=3)
    expected = whole[0][whole[0]["epoch"] < 3]
    found = pd.read_csv(table)
    pd.testing.assert_frame_equal(found.drop(columns=CLOCKS), expected.drop(columns=CLOCKS))


def test_a_new_run_begins_a_new_table(tmp_path):
    fit(tmp_path, epochs=2)
    table = tmp_path / "csv" / "metrics.csv"
    expected = pd.read_csv(table).drop(columns=CLOCKS)
    (tmp_path / "checkpoints" / "last.ckpt").unlink()
    fit(tmp_path, epochs=2)
    pd.testing.assert_frame_equal(pd.read_csv(table).drop(columns=CLOCKS), expected)
