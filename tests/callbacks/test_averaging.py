"""Averaged weights with counts that are not."""

from types import SimpleNamespace

import pytest
import pytorch_lightning as pl
import torch

from diffstack_mmv.callbacks import AveragedWeights

# stand-ins for the trainer of Lightning
pytestmark = pytest.mark.usefixtures("unchecked")


class Counted(pl.LightningModule):
    """A weight, and the number of its steps."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))
        self.register_buffer("steps", torch.zeros((), dtype=torch.long))


def test_weights_are_averaged_and_steps_are_counted():
    module, callback = Counted(), AveragedWeights(decay=0.5)
    callback.setup(None, module, "fit")
    for step in (1, 2, 3):
        module.weight.data += 1.0
        module.steps += 1
        callback.on_train_batch_end(SimpleNamespace(global_step=step), module, None, None, step)
    checkpoint = {"state_dict": module.state_dict()}
    callback.on_save_checkpoint(None, module, checkpoint)
    # after the first step, which it takes over, half of each next one
    assert float(checkpoint["state_dict"]["weight"]) == 0.5 * (0.5 * 1 + 0.5 * 2) + 0.5 * 3
    assert int(checkpoint["state_dict"]["steps"]) == 3
