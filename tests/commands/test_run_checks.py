"""Checks of folders that commands have written."""

import re

import pytest
from omegaconf import OmegaConf

from diffstack_mmv.commands.run_checks import (
    config_file,
    require_own_folder,
    require_reports,
    require_same_run,
)
from scripts import identify


@pytest.fixture
def report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metrics.json").write_text("{}")


@pytest.mark.usefixtures("report")
def test_folders_with_a_report_pass():
    require_reports(["a", "b"])


@pytest.mark.usefixtures("report")
@pytest.mark.parametrize("runs", [["a", "b", "a"], ["a", "b", "./a"]])
def test_a_folder_that_is_named_twice_is_refused(runs):
    told = f"`runs` must name each folder once, but got a and {runs[2]}. Leave one of them out."
    with pytest.raises(ValueError, match=re.escape(told)):
        require_reports(runs)


@pytest.mark.parametrize(
    ("runs", "told"), [([], "name at least one folder"), (["none"], "be an existing file")]
)
def test_runs_without_a_report_are_refused(runs, told):
    with pytest.raises(ValueError, match=f"`runs` must {told}"):
        require_reports(runs)


@pytest.mark.parametrize(
    ("name", "file", "maker"),
    [
        ("evaluate", "checkpoints/last.ckpt", "train"),
        ("compare", "metrics.json", "evaluate"),
        ("navigate", "tests.csv", "compare"),
    ],
)
def test_a_folder_of_another_command_is_refused(tmp_path, name, file, maker):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).touch()
    told = f"`out` must hold results of {name} alone, but got {file} of {maker} in {tmp_path}."
    with pytest.raises(ValueError, match=re.escape(told)):
        require_own_folder(tmp_path, name)
    require_own_folder(tmp_path, maker)
    require_own_folder(tmp_path, "report")
    require_own_folder(tmp_path / "report", name)


def test_results_of_other_settings_are_not_replaced(tmp_path):
    (tmp_path / "config.yaml").write_text("seed: 0\nloss: {_target_: a.Loss, margin: 1.0}\n")
    again = {"seed": 0, "loss": {"_target_": "a.Loss", "margin": 1.0}, "wandb": "none"}
    require_same_run(tmp_path, "tune", {"seed": 1})
    (tmp_path / "rounds.json").touch()
    require_same_run(tmp_path, "tune", again)
    told = (
        "`out` must hold no result of tune with another loss.margin than 2.0, but got 1.0 in "
        f"{tmp_path / 'config.yaml'}. Give another out=FOLDER, or delete {tmp_path}."
    )
    with pytest.raises(ValueError, match=re.escape(told)):
        require_same_run(tmp_path, "tune", again | {"loss": {"_target_": "a.Loss", "margin": 2.0}})


@pytest.mark.parametrize("text", ["a: [", ""])
def test_a_folder_whose_configuration_is_broken_is_refused(tmp_path, text):
    (tmp_path / "config.yaml").write_text(text)
    (tmp_path / "rounds.json").touch()
    with pytest.raises(ValueError, match=r"`out` must be a .*config.yaml.* Give another out=FOL"):
        require_same_run(tmp_path, "tune", {"seed": 0})


def test_an_identification_of_other_settings_is_not_replaced(tmp_path):
    """Its vehicle, and figures that only one of them draws, would be taken for those of both."""
    (tmp_path / "config.yaml").write_text(f"out: {tmp_path}\nprofile: [wheelbase]\n")
    (tmp_path / "identification.json").touch()
    config = OmegaConf.create({"out": str(tmp_path), "profile": ["wheelbase"]})
    identify.admit(config)
    config.profile = []
    with pytest.raises(ValueError, match="no result of identify with another profile"):
        identify.admit(config)


@pytest.mark.parametrize(
    ("name", "file"), [("train", "config.yaml"), ("report", "report_config.yaml")]
)
def test_the_configuration_of_a_run_is_not_that_of_a_page_beside_it(tmp_path, name, file):
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "last.ckpt").touch()
    assert config_file(tmp_path, name) == tmp_path / file
    assert config_file(tmp_path / "elsewhere", name) == tmp_path / "elsewhere" / "config.yaml"
