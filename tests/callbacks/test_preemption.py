"""A training that is told to end saves where it stands, and goes on from there."""

import os
import signal

import pytest
import pytorch_lightning as pl
import torch
from torch.utils.data import DataLoader

from diffstack_mmv.callbacks import Preemption

BATCHES = 6


class Counter(pl.LightningModule):
    """Adds up its batches; sends its process a signal in one of them."""

    def __init__(self, signalled=None, at=None):
        super().__init__()
        self.total = torch.nn.Parameter(torch.zeros(()))
        self.signalled, self.at = signalled, at

    def training_step(self, batch, batch_idx):
        if batch_idx == self.at:
            os.kill(os.getpid(), self.signalled)
        return -self.total * batch.sum()

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=1.0)


def fit(folder, module, resume=None, added_up=1):
    trainer = pl.Trainer(
        max_epochs=1, accelerator="cpu", logger=False, default_root_dir=str(folder),
        accumulate_grad_batches=added_up,
        enable_progress_bar=False, enable_model_summary=False,
        callbacks=[Preemption(str(folder / "last.ckpt"))],
    )  # fmt: skip
    trainer.fit(module, DataLoader(torch.arange(float(BATCHES))), ckpt_path=resume)
    return trainer


@pytest.mark.parametrize("told", [signal.SIGTERM, signal.SIGUSR1])
def test_a_signal_saves_a_checkpoint_and_ends_with_one_message(told, tmp_path):
    before = signal.getsignal(told)
    with pytest.raises(InterruptedError, match=f"Stopped by {told.name}.*same command again"):
        fit(tmp_path, Counter(told, 2))
    saved = torch.load(tmp_path / "last.ckpt", weights_only=True)
    assert saved["global_step"] == 3
    assert float(saved["state_dict"]["total"]) == 0.0 + 1 + 2
    assert signal.getsignal(told) == before


def test_the_run_goes_on_within_the_epoch(tmp_path):
    with pytest.raises(InterruptedError):
        fit(tmp_path, Counter(signal.SIGUSR1, 2))
    trainer = fit(tmp_path, Counter(), tmp_path / "last.ckpt")
    assert trainer.global_step == BATCHES


def test_gradients_that_are_added_up_are_not_cut_in_two(tmp_path):
    with pytest.raises(InterruptedError):
        fit(tmp_path, Counter(signal.SIGUSR1, 2), added_up=2)
    saved = torch.load(tmp_path / "last.ckpt", weights_only=True)
    assert saved["global_step"] == 2
    assert float(saved["state_dict"]["total"]) == (0.0 + 1 + 2 + 3) / 2


def test_an_epoch_that_is_nearly_over_is_brought_to_its_end(tmp_path):
    assert fit(tmp_path, Counter(signal.SIGUSR1, BATCHES - 1)).global_step == BATCHES
    assert not (tmp_path / "last.ckpt").exists()


@pytest.mark.parametrize(("job", "asked"), [("17", "requeue 17\n"), (None, "")])
def test_a_job_of_slurm_is_put_back_into_its_queue(job, asked, tmp_path, monkeypatch):
    tool, said = tmp_path / "scontrol", tmp_path / "said"
    tool.write_text(f'#!/bin/sh\necho "$@" >> {said}\n')
    tool.chmod(0o755)
    said.touch()
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    trainer = Counter(signal.SIGUSR1, 0)
    # known to Lightning's own plugin only after the trainer is built
    if job:
        monkeypatch.setenv("SLURM_JOB_ID", job)
    with pytest.raises(InterruptedError):
        fit(tmp_path, trainer)
    assert said.read_text() == asked


@pytest.mark.parametrize(("status", "told"), [(0, []), (1, ["job 17: no such job"])])
def test_a_queue_that_takes_no_job_back_is_told(status, told, tmp_path, monkeypatch, caplog):
    tool = tmp_path / "scontrol"
    tool.write_text(f"#!/bin/sh\necho no such job >&2\nexit {status}\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    with pytest.raises(InterruptedError):
        fit(tmp_path, Counter(signal.SIGUSR1, 0))
    found = [each.getMessage() for each in caplog.records if "scontrol" in each.getMessage()]
    assert [each.partition("requeue ")[2] for each in found] == told
