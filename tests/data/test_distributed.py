"""The data module in two processes."""

import json

import pytest
import pytorch_lightning as pl
import torch
from torchmetrics import MeanMetric

from diffstack_mmv.data import LoaderSettings, TrajdataModule

pytestmark = pytest.mark.slow


class Shares(pl.LightningModule):
    """Writes down which samples each process sees, and a metric over all of them."""

    def __init__(self, folder):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))
        self.mean, self.folder, self.seen = MeanMetric(), folder, []

    def training_step(self, batch, batch_idx):
        self.seen += batch.goal.sum(-1).tolist()
        return self.weight * batch.goal.sum()

    def on_train_end(self):
        self._write("train", self.seen)

    def test_step(self, batch, batch_idx):
        self.mean.update(batch.goal.norm(dim=-1))

    def on_test_epoch_end(self):
        self._write("test", self.mean.compute().item())

    def _write(self, name, value):
        (self.folder / f"{name}_{self.global_rank}.json").write_text(json.dumps(value))

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.0)


def run(folder, data, processes):
    folder.mkdir()
    options = {"strategy": "ddp_fork"} if processes > 1 else {}
    trainer = pl.Trainer(
        accelerator="cpu",
        devices=processes,
        max_epochs=1,
        limit_val_batches=0,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        **options,
    )
    trainer.fit(Shares(folder), datamodule=data)
    trainer.test(Shares(folder), datamodule=data, verbose=False)
    return [
        [json.loads((folder / f"{name}_{rank}.json").read_text()) for rank in range(processes)]
        for name in ("train", "test")
    ]


def test_two_processes_share_training_and_agree_with_one_on_the_metrics(
    source, windows, exporting, tmp_path
):
    def data(batch_size):
        return TrajdataModule(source, windows, LoaderSettings(batch_size), exporting)

    (first, second), metrics = run(tmp_path / "two", data(4), 2)
    (whole,), (alone,) = run(tmp_path / "one", data(8), 1)
    assert len(first) == len(second) == len(whole) // 2
    left_out = len(whole) % 2
    assert sorted(first + second) == sorted(whole[: len(whole) - left_out])
    assert metrics == pytest.approx([alone, alone], rel=1e-6)
