"""The folder of a run that is given none."""

import subprocess
import sys

import pytest
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from diffstack_mmv.commands.cli import command
from dmmv_conventions.configs import config_folder

PROGRAM = """
from pathlib import Path
from diffstack_mmv.commands.cli import command
command(Path("configs").resolve(), "task")(lambda config: print(config.out))()
"""


@pytest.fixture
def configs(tmp_path, monkeypatch):
    """Configurations of a task that would always begin at noon."""
    shared = OmegaConf.load(config_folder() / "command.yaml")
    begun = {"job": {"name": "task"}, "output_subdir": None}
    out = OmegaConf.to_container(shared)["out"].replace("${now:%Y-%m-%d_%H-%M-%S}", "noon")
    content = OmegaConf.merge(shared, {"seed": 0, "out": out, "hydra": begun})
    (tmp_path / "configs").mkdir()
    OmegaConf.save(content, tmp_path / "configs" / "task.yaml")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "configs"


@pytest.fixture
def folders(configs, monkeypatch, tmp_path):
    """Run the task with some words; the folders of its jobs, as seen from the present one."""

    def run(*words):
        seen = []
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["task", *words])
        command(configs, "task")(lambda config: seen.append(config.out))()
        GlobalHydra.instance().clear()
        return [out.removeprefix(f"{tmp_path}/") for out in seen]

    return run


def test_commands_that_start_at_once_have_a_folder_each(configs, tmp_path):
    call = [sys.executable, "-c", PROGRAM]
    begun = [subprocess.Popen(call, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    told = sorted(process.communicate()[0].strip() for process in begun)
    assert told == [f"{tmp_path}/outputs/task/noon", f"{tmp_path}/outputs/task/noon-2"]
    assert [process.returncode for process in begun] == [0, 0]


def test_a_taken_name_is_numbered_and_a_folder_that_is_given_is_taken_as_it_is(folders):
    assert folders() == ["outputs/task/noon"]
    assert folders() == ["outputs/task/noon-2"]
    assert folders("out=outputs/task/noon") == ["outputs/task/noon"]
    assert folders("hydra.run.dir=elsewhere") == ["elsewhere"]
    assert folders() == ["outputs/task/noon-3"]


def test_a_sweep_tells_its_folder_to_its_jobs(folders, monkeypatch):
    monkeypatch.setattr("diffstack_mmv.commands.command_line.datetime", _Noon)
    for own in ("noon", "noon-2"):
        assert folders("-m", "seed=1,2") == [f"outputs/task/{own}/{job}" for job in (0, 1)]
    assert folders("-m", "seed=1,2", "out=given") == ["given/0", "given/1"]


class _Noon:
    """A clock that has stopped."""

    @classmethod
    def now(cls):
        return cls()

    def __format__(self, wanted):
        return "noon"


def test_further_processes_of_a_run_are_in_the_folder_of_the_first(folders, monkeypatch):
    assert folders() == ["outputs/task/noon"]
    monkeypatch.setenv("RANK", "1")
    assert folders() == ["outputs/task/noon"]


def test_a_folder_that_cannot_be_made_is_told(folders, tmp_path, capsys):
    (tmp_path / "outputs").write_text("a file")
    with pytest.raises(SystemExit):
        folders()
    assert "outputs" in capsys.readouterr().err
