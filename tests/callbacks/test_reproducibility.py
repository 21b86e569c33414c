"""Where a checkpoint comes from, and random numbers that go on where they stopped."""

import random

import numpy as np
import pytest
import torch

from diffstack_mmv.callbacks import Provenance, RandomState, resume_point

CONFIG = {"data": "a", "dynamics": "kbm", "seed": 0, "epochs": 2}

# stand-ins for the trainer and the module of Lightning
pytestmark = pytest.mark.usefixtures("unchecked")


def draw():
    return random.random(), np.random.random(), torch.rand(()).item()


def save(folder, config):
    checkpoint = {}
    Provenance(config).on_save_checkpoint(None, None, checkpoint)
    path = folder / "checkpoints" / "last.ckpt"
    path.parent.mkdir(exist_ok=True)
    torch.save(checkpoint, path)
    return path


def test_generators_go_on_as_if_never_stopped(tmp_path):
    saved = RandomState()
    torch.save(saved.state_dict(), tmp_path / "state.pt")
    expected = draw()
    restored = RandomState()
    restored.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
    draw()
    restored.on_train_start(None, None)
    assert draw() == expected


def test_a_fresh_run_leaves_the_generators_alone():
    torch.manual_seed(3)
    expected = torch.rand(()).item()
    torch.manual_seed(3)
    RandomState().on_train_start(None, None)
    assert torch.rand(()).item() == expected


def test_a_run_resumes_from_its_own_checkpoint(tmp_path):
    path = save(tmp_path, CONFIG)
    assert resume_point(path, CONFIG | {"epochs": 9}) == path


def test_there_is_nothing_to_resume_in_a_new_folder(tmp_path):
    assert resume_point(tmp_path / "checkpoints" / "last.ckpt", CONFIG) is None


@pytest.mark.parametrize("changed", [{"dynamics": "gm3"}, {"seed": 1}, {"data": "b"}])
def test_another_run_in_the_same_folder_is_refused(changed, tmp_path):
    with pytest.raises(ValueError, match=f"another {next(iter(changed))}"):
        resume_point(save(tmp_path, CONFIG), CONFIG | changed)


def test_a_checkpoint_tells_configuration_commit_and_versions(tmp_path):
    stored = torch.load(save(tmp_path, CONFIG), weights_only=True)["provenance"]
    assert stored["config"] == CONFIG
    assert {"commit", "torch", "diffstack_mmv"} <= set(stored)
