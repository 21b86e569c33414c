"""The command that trains the whole stack, killed anywhere: it ends as if nothing had happened."""

import os
import signal

import pandas as pd
import pytest
import torch

from benchmarks.faults.workplace import base, said
from diffstack_mmv.callbacks import WholeCheckpoints
from diffstack_mmv.stack import DiffStackMMV

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unchecked")]
# what a clock says differs from run to run
CLOCKS = "^(?!throughput)"


def die(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)


def dying(owner, name, call):
    """Let the nth call of a function kill the process."""

    def prepare():
        original, count = getattr(owner, name), iter(range(1, 1000))
        setattr(owner, name, lambda *a, **k: die() if next(count) == call else original(*a, **k))

    return prepare


def in_a_write(number):
    """Die in the place of the write of a checkpoint."""

    return dying(WholeCheckpoints, "save_checkpoint", number)


def train(out, prepare=lambda: None):
    """Train in a process of its own; whether it was killed."""
    options = [*base("train"), "epochs=3", "trainer.limit_train_batches=2", "dynamics=unicycle"]
    child = os.fork()
    if child == 0:
        prepare()
        told = said("train", [*options, f"out={out}"])
        os._exit(0 if told is None else 1)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def result(out):
    """Table, weights of both checkpoints, and the best score."""
    table = pd.read_csv(out / "csv" / "metrics.csv").filter(regex=CLOCKS)
    names = ("best", "last")
    files = [torch.load(out / "checkpoints" / f"{n}.ckpt", weights_only=True) for n in names]
    states = files[1]["callbacks"]
    (best,) = (
        state
        for name, state in states.items()
        if name.startswith("ModelCheckpoint{'monitor': 'val")
    )
    scores = [float(best["best_model_score"]), [file["global_step"] for file in files]]
    return table, [file["state_dict"] for file in files], scores


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    assert not train(out)
    return result(out)


KILLS = {
    "in an epoch": dying(DiffStackMMV, "training_step", 4),
    "in validation": dying(DiffStackMMV, "validation_step", 2),
    "while a checkpoint is written": in_a_write(3),
    "between best and last": in_a_write(2),
}


@pytest.mark.parametrize("kill", KILLS)
def test_a_killed_training_ends_as_the_uninterrupted_one(kill, whole, tmp_path):
    assert train(tmp_path, KILLS[kill])
    assert not train(tmp_path)
    table, weights, scores = result(tmp_path)
    pd.testing.assert_frame_equal(table, whole[0])
    for found, expected in zip(weights, whole[1], strict=True):
        assert all(torch.equal(found[name], expected[name]) for name in expected)
    assert scores == whole[2]
