"""A checkpoint takes the place of the earlier one when it is whole."""

import resource

import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from diffstack_mmv.callbacks import WholeCheckpoints


def test_a_checkpoint_that_cannot_be_written_leaves_the_earlier_one(tmp_path):
    path, files = tmp_path / "run" / "last.ckpt", WholeCheckpoints()
    files.save_checkpoint({"epoch": 1}, path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            files.save_checkpoint({"epoch": 2}, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert files.load_checkpoint(path, weights_only=True) == {"epoch": 1}
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("name", ["cpu", "gpu", "ddp"])
def test_every_trainer_writes_checkpoints_beside_the_earlier_ones(name, root):
    folder = root / "configs" / "trainer"
    files = ("cpu", name) if name != "cpu" else ("cpu",)
    config = OmegaConf.merge(*(OmegaConf.load(folder / f"{file}.yaml") for file in files))
    assert isinstance(instantiate(config.plugins)[0], WholeCheckpoints)
