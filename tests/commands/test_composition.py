"""A configuration is composed once, and values are compared with the defaults of its groups."""

import contextlib
import sys

import pytest
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from diffstack_mmv.commands import composition
from diffstack_mmv.commands.cli import command
from diffstack_mmv.commands.composition import (
    as_written,
    changed_defaults,
    is_in_part,
    refuse_beside,
    require_resolved,
    settings_in,
)

CONTENT = """
defaults: [part: coarse, _self_]
count: 1
out: out
hydra:
  run: {dir: "${out}"}
  sweep: {dir: "${out}", subdir: "${hydra.job.num}"}
  output_subdir: null
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a task as a command line; what the task returned of each job."""
    configs = tmp_path / "configs"
    (configs / "part").mkdir(parents=True)
    (configs / "task.yaml").write_text(CONTENT)
    for name, step in (("coarse", 0.5), ("fine", 0.1)):
        (configs / "part" / f"{name}.yaml").write_text(f"step: {step}")
    monkeypatch.chdir(tmp_path)

    def go(*arguments, task=lambda config: dict(changed_defaults("task"))):
        found = []
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["task", *arguments, f"out={tmp_path / 'out'}"])
        with contextlib.suppress(SystemExit):
            command(configs, "task")(lambda config: found.append(task(config)))()
        GlobalHydra.instance().clear()
        for each in found:
            each.pop("out")
        return found

    return go


def test_defaults_are_those_of_the_groups_that_are_chosen(run):
    assert run("part=fine", "part.step=2", "+part.new=3", "++count=4") == [{"part.step": 0.1}]


def test_a_job_that_was_started_elsewhere_composes_them_again(run):
    def elsewhere(config):
        composition._DEFAULTS.set(None)
        return dict(changed_defaults("task"))

    assert run("part=fine", "part.step=2", task=elsewhere) == [{"part.step": 0.1}]


@pytest.mark.parametrize("arguments", [("-m", "count=2,3"), ("hydra.mode=MULTIRUN", "count=2,3")])
def test_each_job_of_a_sweep_has_its_own(arguments, run):
    assert run(*arguments) == [{"count": 1}, {"count": 1}]


def test_a_configuration_is_composed_once(run, monkeypatch):
    composed, load = [], ConfigLoaderImpl.load_configuration

    def counted(*args, **kwargs):
        composed.append(kwargs)
        return load(*args, **kwargs)

    monkeypatch.setattr(ConfigLoaderImpl, "load_configuration", counted)
    assert run("count=2") == [{"count": 1}]
    assert len(composed) == 1


def test_settings_of_a_command_line_are_read_as_by_hydra():
    words = ["a=1", "+b.c='x y'", "++a=[2]", "d=null", "e=1", "~e", "data@other=f"]
    found = settings_in(words)
    assert found == {"a": [2], "b.c": "x y", "d": None, "data@other": "f"}
    with pytest.raises(ValueError, match=r"`settings` must read key=value, but got 'a=\[1'"):
        settings_in(["a=[1"])


def test_interpolations_are_seen_as_they_were_written(run):
    def written(config):
        return OmegaConf.to_container(as_written("task"))

    assert run("+twice=${count}", "count=3", task=written) == [
        {"part": {"step": 0.5}, "count": 3, "twice": "${count}"}
    ]


@pytest.mark.parametrize(
    ("key", "inside"),
    [
        ("part.size", True),
        ("part.deep.size", True),
        ("vehicle.friction", True),
        ("limits.speed", False),
        ("part", False),
        ("seed", False),
    ],
)
def test_a_key_within_what_is_built_is_told_from_a_setting_of_the_command(key, inside):
    part = {"_target_": "some.Part", "size": 1, "deep": {"size": 2}}
    config = OmegaConf.create({"part": part, "limits": {"speed": 1}, "vehicle": {}, "seed": 0})
    assert is_in_part(config, key) is inside


def test_a_formula_that_does_not_take_its_values_is_named():
    config = OmegaConf.create({"a": {"low": "${smaller:${b},1.0}"}, "b": "fast", "c": "${b}"})
    with pytest.raises(ValueError, match="`a.low` must be a value, but got an interpolation"):
        require_resolved(config)


@pytest.mark.parametrize("word", ["part=fine", "part.step=2", "+part.new=3"])
def test_what_another_setting_replaces_is_refused_by_name(run, word):
    def task(_):
        with pytest.raises(ValueError, match="`count` must be without what it replaces, .* part"):
            refuse_beside("count", ["part"])
        return {"out": None}

    assert run("count=2", word, task=task) == [{}]


def test_other_settings_beside_it_are_kept(run):
    def task(config):
        refuse_beside("count", ["part"])
        return dict(config)

    assert run("count=2", task=task) == [{"count": 2, "part": {"step": 0.5}}]
