"""Where a checkpoint comes from, and random numbers that go on where they stopped."""

import random
import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from diffstack_mmv.callbacks import EarlyStopping, Provenance, RandomState, resume_point
from diffstack_mmv.callbacks.reproducibility import current_commit

CONFIG = {
    **{"data": "a", "dynamics": "kbm", "seed": 0, "epochs": 2, "out": "here", "start": None},
    "optim": {"optimizer": {"lr": 0.002}, "scheduler": {"T_max": 2}},
    "physics": {"rate": 0.1},
    "stack": {"precision": None, "optimizer": {"lr": 0.002}},
    "trainer": {"accelerator": "cpu", "max_epochs": 2, "gradient_clip_val": 1.0},
    "callbacks": {"last": {"dirpath": "here/checkpoints"}, "progress": {"rate": 1}},
}

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


def restored(state, rank=0):
    """What a process draws first that goes on from a saved state."""
    generators = RandomState()
    generators.load_state_dict(state)
    draw()
    generators.on_train_start(SimpleNamespace(global_rank=rank), None)
    return draw()


def test_generators_go_on_as_if_never_stopped(tmp_path):
    torch.save(RandomState().state_dict(), tmp_path / "state.pt")
    expected = draw()
    assert restored(torch.load(tmp_path / "state.pt", weights_only=True)) == expected


def test_each_process_goes_on_with_its_own_numbers():
    states, expected = [], []
    for seed in (1, 2):
        torch.manual_seed(seed)
        states += RandomState().state_dict()["processes"]
        expected.append(draw())
    assert expected[0] != expected[1]
    for rank in (0, 1):
        assert restored({"processes": states}, rank) == expected[rank]


def test_a_process_that_was_not_there_before_keeps_its_numbers():
    state = RandomState().state_dict()
    torch.manual_seed(5)
    expected = [draw()[2] for _ in range(2)][1]
    torch.manual_seed(5)
    assert restored(state, rank=1)[2] == expected


def test_a_checkpoint_of_an_earlier_version_restores_the_first_process():
    [state] = RandomState().state_dict()["processes"]
    expected = draw()
    assert restored(state) == expected


def test_a_fresh_run_leaves_the_generators_alone():
    torch.manual_seed(3)
    expected = torch.rand(()).item()
    torch.manual_seed(3)
    RandomState().on_train_start(SimpleNamespace(global_rank=0), None)
    assert torch.rand(()).item() == expected


def test_a_run_resumes_from_its_own_checkpoint(tmp_path):
    path = save(tmp_path, CONFIG)
    assert resume_point(path, CONFIG | {"epochs": 9}) == path


CHANGES = {
    "optim.optimizer.lr": {"optim": {"optimizer": {"lr": 0.1}, "scheduler": {"T_max": 2}}},
    "optim.scheduler.T_max": {"optim": {"optimizer": {"lr": 0.002}, "scheduler": {"T_max": 4}}},
    "optim.scheduler": {"optim": {"optimizer": {"lr": 0.002}, "scheduler": None}},
    "stack.precision": {"stack": {"precision": {"dtype": "b"}, "optimizer": {"lr": 0.002}}},
    "start": {"start": "a.ckpt"},
    "physics.rate": {"physics": {"rate": 1.0}},
    "trainer.gradient_clip_val": {"trainer": {"gradient_clip_val": 2.0}},
    "callbacks.ema.decay": {"callbacks": CONFIG["callbacks"] | {"ema": {"decay": 0.9}}},
}


@pytest.mark.parametrize("place", CHANGES)
def test_a_setting_of_the_training_is_not_changed_silently(place, tmp_path):
    with pytest.raises(ValueError, match=rf"another {re.escape(place)}.*before, now .*start="):
        resume_point(save(tmp_path, CONFIG), CONFIG | CHANGES[place])


def test_a_run_goes_on_elsewhere_for_longer_and_with_another_display(tmp_path):
    path = save(tmp_path, CONFIG)
    moved = {"out": "there", "epochs": 9, "logger": {"csv": {"save_dir": "there"}}}
    moved["trainer"] = CONFIG["trainer"] | {"accelerator": "gpu", "devices": 2, "max_epochs": 9}
    moved["callbacks"] = {"last": {"dirpath": "there/checkpoints"}, "progress": None}
    assert resume_point(path, CONFIG | moved) == path


@pytest.mark.parametrize("told", [True, False])
def test_a_cache_may_lie_elsewhere_if_the_checkpoint_tells_its_content(told, tmp_path):
    def of(cache):
        source, export = {"folder": cache}, {"folder": f"{cache}/exports"}
        return CONFIG | {"data": {"cache": cache, "module": {"source": source, "export": export}}}

    path = save(tmp_path, of("disk"))
    if told:
        torch.save(torch.load(path) | {"TrajdataModule": {"recordings": "a hash"}}, path)
        assert resume_point(path, of("local")) == path
        return
    with pytest.raises(ValueError, match=r"another data\.cache: 'disk' before, now 'local'"):
        resume_point(path, of("local"))


def test_patience_ends_no_run_that_was_not_validated():
    stopping, trainer = EarlyStopping("val/ade", patience=0), SimpleNamespace(should_stop=False)
    stopping.on_train_start(trainer, None)
    assert not trainer.should_stop
    stopping.wait_count = 1
    stopping.on_train_start(trainer, None)
    assert trainer.should_stop


def test_there_is_nothing_to_resume_in_a_new_folder(tmp_path):
    assert resume_point(tmp_path / "checkpoints" / "last.ckpt", CONFIG) is None


@pytest.mark.parametrize("changed", [{"dynamics": "gm3"}, {"seed": 1}, {"data": "b"}])
def test_another_run_in_the_same_folder_is_refused(changed, tmp_path):
    with pytest.raises(ValueError, match=f"another {next(iter(changed))}"):
        resume_point(save(tmp_path, CONFIG), CONFIG | changed)


def test_a_checkpoint_tells_what_was_learned_from_once_it_is_read():
    names, checkpoint = {}, {}
    callback = Provenance(CONFIG, lambda: names)
    names["a"] = ["1"]
    callback.on_save_checkpoint(None, None, checkpoint)
    assert checkpoint["provenance"]["data"] == {"a": ["1"]}


def test_a_checkpoint_tells_configuration_commit_and_versions(tmp_path):
    stored = torch.load(save(tmp_path, CONFIG), weights_only=True)["provenance"]
    assert stored["config"] == CONFIG
    assert {"commit", "torch", "diffstack_mmv"} <= set(stored)


@pytest.mark.parametrize(
    "content", [{}, {"provenance": None}, {"provenance": {"config": "text"}}, [1]]
)
def test_a_checkpoint_without_its_configuration_is_refused_with_a_remedy(content, tmp_path):
    path = tmp_path / "last.ckpt"
    torch.save(content, path)
    with pytest.raises(ValueError, match=r"`checkpoint` must hold its configuration.*Delete it to"):
        resume_point(path, CONFIG)


@pytest.mark.parametrize("installed", [False, True], ids=["no git", "no repository"])
def test_a_commit_that_cannot_be_told_is_unknown(installed, tmp_path, monkeypatch):
    if installed:
        (tmp_path / "git").write_text("#!/bin/sh\nexit 128\n")
        (tmp_path / "git").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert current_commit() == "unknown"
