"""Settings that were once taken as they were, or refused without being named."""

from typing import get_args

import pytest
from lightning_fabric.plugins.precision.precision import _PRECISION_INPUT
from pytorch_lightning.accelerators import AcceleratorRegistry
from pytorch_lightning.strategies import StrategyRegistry

from benchmarks.faults.configuration import words
from benchmarks.faults.workplace import base, said
from diffstack_mmv.training_checks import ACCELERATORS, PRECISIONS, STRATEGIES

WRONG = [
    ("train", "seed=-1", "`seed` must lie in"),
    ("train", "vehicle.name=[1]", "`name` must be text"),
    ("train", "validation.share=2.5", "`validation.share` must lie in (0, 1]"),
    ("train", "validation.every_epochs=0", "`validation.every_epochs` must be at least 1"),
    ("train", "validation.every_epochs=-2", "`validation.every_epochs` must be at least 1"),
    ("train", "trainer.gradient_clip_val=-1", "`trainer.gradient_clip_val` must be at least 0"),
    ("train", "trainer.log_every_n_steps=-1", "`trainer.log_every_n_steps` must be at least 1"),
    (
        "train",
        "trainer.limit_train_batches=2.5",
        "`trainer.limit_train_batches` must lie in (0, 1]",
    ),
    ("train", "trainer.devices=0", "`trainer.devices` must be a number of devices, a list of"),
    ("train", "trainer.devices=9999", "`trainer.devices` must be at most"),
    ("train", "trainer.devices=many", "`trainer.devices` must be a number of devices"),
    ("train", "+trainer.precision=17", "`trainer.precision` must be one of 16, 16-mixed"),
    ("train", "+trainer.strategy=pdd", "`trainer.strategy` must begin with one of auto, ddp"),
    ("train", "+trainer.max_steps=some", "`trainer.max_steps` must be a whole number"),
    ("train", "+trainer.num_nodes=0", "`trainer.num_nodes` must be at least 1"),
    ("train", "+trainer.foo=1", "`trainer.foo` must be an argument of pytorch_lightning.Trainer"),
    ("train", "+callbacks.early_stopping.patiens=1", "Did you mean `patience`?"),
    ("train", "+optim.optimizer.bettas=1", "`optim.optimizer.bettas` must be an argument of torch"),
    ("train", "trainer.accelerator=car", "`trainer.accelerator` must be one of auto, cpu"),
    ("train", "optim.optimizer.lr=-1", "`optim.optimizer.lr` must be at least 0"),
    ("evaluate", "device=9", "`device` must be auto, cpu, or a device of this machine"),
    ("evaluate", "horizon_s=x", "`horizon_s` must be a number"),
    ("evaluate", "situations=[horse]", "`situations` must be one of moving"),
    ("compare", "score=horse", "`score` must be one of"),
    ("identify", "tracks=0", "`tracks` must be at least 1"),
    ("identify", "parameters=[grip]", "`parameters` must be one of wheelbase"),
    ("identify", "foresee_s=-1", "`prediction_s` must be at least 0"),
    ("navigate", "animate=-1", "`animate` must be at least 0"),
    ("simulate", "speed_mps=nan", "`speed_mps` must be at least 0"),
    ("report", "episodes=-1", "`episodes` must be at least 0"),
    ("report", "page=.", "`page` must be a file"),
    ("results", "size.goals=[horse]", "`goal` must be one of future"),
    ("results", "size.seeds=[]", "`size.seeds` must name at least one"),
    ("results", "launcher.processes=0", "`processes` must be at least 1"),
]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("script", "setting", "told"), WRONG)
def test_a_setting_that_cannot_be_is_named(script, setting, told, tmp_path):
    arguments = [*base(script), f"out={tmp_path / 'out'}", *words(setting)]
    assert told in (said(script, arguments) or "nothing")


def test_the_accelerators_are_those_of_lightning():
    known = set(AcceleratorRegistry.available_accelerators())
    assert known <= set(ACCELERATORS)
    assert set(ACCELERATORS) <= known | {"auto", "gpu"}


def test_the_precisions_and_strategies_are_those_of_lightning():
    known = {str(each) for kind in get_args(_PRECISION_INPUT) for each in get_args(kind)}
    assert known == set(PRECISIONS)
    assert all(name.startswith(STRATEGIES) for name in StrategyRegistry.available_strategies())
