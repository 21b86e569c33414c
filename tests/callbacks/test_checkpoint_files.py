"""A checkpoint takes the place of the earlier one when it is whole."""

import os

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from diffstack_mmv.callbacks import WholeCheckpoints


def test_a_checkpoint_that_cannot_be_written_leaves_the_earlier_one(tmp_path, monkeypatch):
    path, files = tmp_path / "run" / "last.ckpt", WholeCheckpoints()
    files.save_checkpoint({"epoch": 1}, path)

    def cut_off(content, file):
        file.write_bytes(b"the beginning")
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(torch, "save", cut_off)
    with pytest.raises(OSError, match="No space left"):
        files.save_checkpoint({"epoch": 2}, path)
    assert files.load_checkpoint(path, weights_only=True) == {"epoch": 1}
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("name", ["cpu", "gpu", "ddp"])
def test_every_trainer_writes_checkpoints_beside_the_earlier_ones(name, root):
    folder = root / "configs" / "trainer"
    files = ("cpu", name) if name != "cpu" else ("cpu",)
    config = OmegaConf.merge(*(OmegaConf.load(folder / f"{file}.yaml") for file in files))
    assert isinstance(instantiate(config.plugins)[0], WholeCheckpoints)
