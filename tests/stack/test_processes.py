"""A training leaves the process that began it as it was, and ends as it was told."""

import signal

import pytest
import pytorch_lightning as pl
import torch
from torch.utils.data import DataLoader

from diffstack_mmv.stack import interrupts_raised


class Ended(pl.LightningModule):
    """A training that ends in its first batch."""

    def __init__(self, by):
        super().__init__()
        self.by, self.weight = by, torch.nn.Parameter(torch.zeros(()))

    def training_step(self, *_):
        raise self.by

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters())


@pytest.mark.parametrize("by", [KeyboardInterrupt(), SystemExit(3), ValueError("no")])
def test_a_training_that_is_interrupted_says_so_and_heeds_the_next_interrupt(by, tmp_path):
    before = signal.getsignal(signal.SIGINT)
    trainer = pl.Trainer(
        accelerator="cpu", logger=False, default_root_dir=str(tmp_path), max_epochs=1,
        enable_progress_bar=False, enable_model_summary=False, enable_checkpointing=False,
    )  # fmt: skip
    with pytest.raises(type(by)), interrupts_raised():
        trainer.fit(Ended(by), DataLoader(torch.zeros(1)))
    assert signal.getsignal(signal.SIGINT) == before
