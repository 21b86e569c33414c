"""Settings that were once taken as they were, or refused without being named."""

import inspect
from typing import Any

import pytest
from pytorch_lightning import Trainer
from pytorch_lightning.accelerators import AcceleratorRegistry
from pytorch_lightning.strategies import StrategyRegistry

from benchmarks.faults.configuration import words
from benchmarks.faults.workplace import base, said
from diffstack_mmv.commands.training_checks import (
    ACCELERATORS,
    CHOICES,
    LEAST,
    SHARES,
    STRATEGIES,
    UNWANTED,
)

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
    ("train", "+trainer.precision=17", "`trainer.precision` must be 64 or 32 or 16 or transf"),
    ("train", "+trainer.strategy=pdd", "`trainer.strategy` must begin with one of auto, ddp"),
    ("train", "+trainer.max_steps=some", "`trainer.max_steps` must be a whole number"),
    ("train", "+trainer.accumulate_grad_batches=0", "`trainer.accumulate_grad_batches` must be at"),
    ("train", "+trainer.max_time=soon", "`trainer.max_time` must be DAYS:HOURS"),
    ("train", "+trainer.val_check_interval=1.5", "`trainer.val_check_interval` must lie in (0, 1]"),
    ("train", "+trainer.overfit_batches=1.5", "`trainer.overfit_batches` must lie in (0, 1]"),
    ("train", "trainer.limit_val_batches=-1", "`trainer.limit_val_batches` must lie in (0, 1]"),
    ("train", "+trainer.gradient_clip_algorithm=l2", "must be one of norm, value, but got 'l2'"),
    ("train", "+trainer.precision=16-mixed", "Half precision where it does no harm is stack=mixed"),
    ("train", "+trainer.profiler=fast", "`trainer.profiler` must be one of advanced, pytorch"),
    ("train", "trainer.deterministic=often", "`trainer.deterministic` must be true or false"),
    ("train", "+trainer.inference_mode=often", "`trainer.inference_mode` must be true or false"),
    ("train", "+trainer.barebones=true", "`trainer.barebones` must be false"),
    ("train", "+trainer.enable_checkpointing=false", "be true beside callbacks.checkpoint and c"),
    ("train", "+trainer.enable_progress_bar=false", "Add callbacks.progress=null."),
    ("train", "watched=ade", "`watched` must be val/SCORE or val/MODE/SCORE with one of ade"),
    ("train", "watched=val/horse/ade", "A mode has to be one of `modes`."),
    (
        "train",
        "loss=prediction",
        "`loss` must reach something that is learned, but got a predictor",
    ),
    ("train", "loss=prediction watched=val/plan_ade", "`watched` must be val/SCORE"),
    ("train", "callbacks.early_stopping.monitor=val/x", "`callbacks.early_stopping.monitor` must"),
    ("train", "+callbacks.early_stopping.mode=up", "`callbacks.early_stopping.mode` must be one"),
    ("train", "callbacks.learning_rate.logging_interval=x", "must be step or epoch or null"),
    (
        "train",
        "+callbacks.checkpoint.save_top_k=3",
        "be 1 beside callbacks.checkpoint.filename=best",
    ),
    (
        "train",
        "~optim.scheduler.T_max ~optim.scheduler.eta_min optim.scheduler._target_="
        "torch.optim.lr_scheduler.ReduceLROnPlateau",
        "`optim.scheduler` must need no monitored score",
    ),
    ("train", "optim.scheduler={max_lr:1}", "Write ~optim.scheduler '+optim.scheduler={...}'"),
    ("train", "+callbacks.checkpoint.save_top_k=-2", "`callbacks.checkpoint.save_top_k` must be a"),
    ("train", "+trainer.num_nodes=0", "`trainer.num_nodes` must be at least 1"),
    ("train", "+trainer.foo=1", "`trainer.foo` must be an argument of pytorch_lightning.Trainer"),
    ("train", "+callbacks.early_stopping.patiens=1", "Did you mean `patience`?"),
    ("train", "+optim.optimizer.bettas=1", "`optim.optimizer.bettas` must be an argument of torch"),
    ("train", "trainer.accelerator=car", "`trainer.accelerator` must be one of auto, cpu"),
    ("train", "+optim.optimizer.betas=[0.9,1.5]", "`optim.optimizer.betas` must lie in [0, 1)"),
    ("train", "+optim.optimizer.eps=-1", "`optim.optimizer.eps` must be at least 0"),
    ("train", "optim.scheduler.T_max=0", "`optim.scheduler.T_max` must be at least 1"),
    ("train", "optim.optimizer.lr=-1", "`optim.optimizer.lr` must be at least 0"),
    ("navigate", "beside=[nothing]", "`beside` must be one of blind, diffmpc, diffmpc_adaptive"),
    ("navigate", "against=[none]", "`against` must be an existing file"),
    ("navigate", "show=[2000]", "`show` must be among the cases that are driven, but got 2000"),
    ("navigate", "dt_s=0.1", "`dt_s` must be that of the controller's model, 0.25, but got 0.1"),
    ("navigate", "phase=tset", "`phase` must be one of test, train, val, but got 'tset'"),
    ("navigate", "scenario.humans=200", "`humans` must fit into the scenario, in which at most 42"),
    ("navigate", "sensing.range_m=0", "`range_m` must be positive, but got 0"),
    (
        "navigate",
        "controller=diffmpc_delay known_delay_s=0.3",
        "`delay` must lie in [0, 0.25], but got 0.3",
    ),
    ("identify", "controls=measure", "`controls` must be measured, or noise by name as in"),
    ("identify", "controls=true", "`controls` must be measured, or noise by name as in"),
    ("identify", "controls=[0.05,0.002]", "`controls` must be measured, or noise by name as in"),
    ("identify", "parameters=wheelbase", "`parameters` must be a list of names"),
    ("evaluate", "device=9", "`device` must be auto, cpu, or a device of this machine"),
    ("evaluate", "horizon_s=x", "`horizon_s` must be a number"),
    ("evaluate", "situations=[horse]", "`situations` must be one of moving"),
    ("evaluate", "data.module.export=null", "`data.module.export` must say where windows are"),
    ("compare", "score=horse", "`score` must be one of"),
    ("identify", "tracks=0", "`tracks` must be at least 1"),
    ("identify", "dt_s=0.2", "`dt_s` must be 0.1 as in the conversion"),
    ("identify", "foresee_s=1.6", "`prediction_s` must be at most half of a segment"),
    ("identify", "controls={steer:0.1}", "`controls` must name acceleration, steer"),
    ("identify", "parameters=[grip]", "`parameters` must be one of wheelbase"),
    ("identify", "foresee_s=-1", "`prediction_s` must be at least 0"),
    ("navigate", "animate=-1", "`animate` must be at least 0"),
    ("simulate", "speed_mps=nan", "`speed_mps` must lie in [0, 1000], but got nan"),
    ("simulate", "+manoeuvre.periods=0", "`periods` must be at least 1, but got 0"),
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


@pytest.mark.usefixtures("unchecked")
def test_a_gpu_that_is_not_there_is_told_before_lightning_is_imported(tmp_path, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setattr("torch.backends.mps.is_available", lambda: False)
    arguments = [*base("train"), f"out={tmp_path / 'out'}", "trainer=gpu"]
    told = said("train", arguments) or "nothing"
    assert "`trainer.accelerator` must be one of this machine, but got 'gpu'" in told


def test_the_accelerators_are_those_of_lightning():
    known = set(AcceleratorRegistry.available_accelerators())
    assert known <= set(ACCELERATORS)
    assert set(ACCELERATORS) <= known | {"auto", "gpu"}


def test_the_strategies_are_those_of_lightning():
    assert all(name.startswith(STRATEGIES) for name in StrategyRegistry.available_strategies())


def test_what_is_judged_of_the_trainer_are_its_arguments():
    judged = {*LEAST, *SHARES, *CHOICES, *UNWANTED}
    assert judged <= set(inspect.signature(Trainer).parameters)


@pytest.mark.parametrize("name", sorted(CHOICES))
def test_lightning_takes_the_choices_and_no_other(name, tmp_path):
    plain: dict[str, Any] = {"accelerator": "cpu", "logger": False, "default_root_dir": tmp_path}
    for choice in set(CHOICES[name]) - {"xla"}:  # which needs a package of its own
        Trainer(**plain, **{name: choice})
    with pytest.raises(Exception, match="foo|can only be one of"):
        Trainer(**plain, **{name: "foo"})
