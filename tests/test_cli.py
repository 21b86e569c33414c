"""What all command lines share: complete configurations, files of vehicles, one message."""

import contextlib
import sys

import pytest
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from diffstack_mmv.cli import command, save_config

CONTENT = """
vehicle: {name: bicycle}
vehicle_file: null
needed: ???
smallest: ${smaller:3,2}
out: out
hydra: {run: {dir: "${out}"}, output_subdir: null}
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a task as a command line; its configuration and what was told on failure."""
    (tmp_path / "task.yaml").write_text(CONTENT)
    monkeypatch.chdir(tmp_path)

    def go(*arguments, task=lambda config: None):
        seen = []
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["task", *arguments, f"out={tmp_path / 'out'}"])

        def keep(config):
            seen.append(config)
            task(config)

        with contextlib.suppress(SystemExit):
            command(tmp_path, "task")(keep)()
        GlobalHydra.instance().clear()
        return (seen[0] if seen else None), capsys.readouterr().err

    return go


def test_a_value_that_must_be_given_is_named(run):
    config, told = run()
    assert config is None
    assert "`needed` must be given. Add needed=VALUE" in told


def test_the_resolved_configuration_is_saved_before_the_work(run, tmp_path):
    def fail(config):
        raise ValueError("`x` must be positive, but got -1.")

    _, told = run("needed=1", task=fail)
    saved = OmegaConf.load(tmp_path / "out" / "config.yaml")
    assert (saved.needed, saved.smallest) == (1, 2)
    assert "`x` must be positive, but got -1." in told


def test_a_vehicle_comes_from_a_file(run, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("name: mine\n")
    config, _ = run("needed=1", f"vehicle={file}")
    assert config.vehicle == {"name": "mine"}


def test_a_missing_vehicle_file_is_named(run):
    _, told = run("needed=1", "vehicle=nowhere.yaml")
    assert "must be a name or an existing YAML file, but got 'nowhere.yaml'" in told


def test_a_failure_shows_no_traceback(run):
    def fail(config):
        raise KeyError("key")

    _, told = run("needed=1", task=fail)
    assert "KeyError: 'key'" in told
    assert "Traceback" not in told


def test_a_bug_is_not_hidden_behind_a_message(run):
    def fail(config):
        raise ZeroDivisionError("a bug")

    _, told = run("needed=1", task=fail)
    assert "Traceback" in told or "ZeroDivisionError" in told


def test_a_configuration_is_replaced_whole(tmp_path):
    for value in (1, 2):
        save_config(OmegaConf.create({"value": value}), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]
    assert OmegaConf.load(tmp_path / "config.yaml").value == 2
