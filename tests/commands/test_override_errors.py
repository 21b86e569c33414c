"""Command lines that Hydra cannot compose: one line that names key, value, place and remedy."""

import sys
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra

from scripts.navigate import main as navigate
from scripts.side_by_side import main as side_by_side
from scripts.side_by_side import names_of
from scripts.train import main


@pytest.fixture
def answer(monkeypatch, capsys, tmp_path):
    """What training answers to a command line it refuses."""

    def run(*arguments):
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["train.py", *arguments, f"out={tmp_path}"])
        with pytest.raises(SystemExit) as ended:
            main()
        GlobalHydra.instance().clear()
        assert ended.value.code == 1
        return capsys.readouterr().err

    return run


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["goal=futur"], "`goal` must be one of future, predicted, wanted, but got 'futur' on the "
         "command line. Did you mean goal=future?"),
        (["goal=null"], "`goal` must be one of future, predicted, wanted, but got null on the "
         "command line. Leave it out for the default."),
        (["epochs=3", "dynamics=1"], "`dynamics` must be one of gm3, "),
        (["dynamics=kbmm"], "but got 'kbmm' on the command line. Did you mean dynamics=kbm"),
        (["vehicle=bike"], "bicycle? A vehicle of your own is the path of a YAML file."),
        (["--config-name", "x"], "`config-name` must be train, but got x on the command line."),
        (["epoch=3"], "`epoch` must be a key of the configuration of train, but got epoch=3 on the"
         " command line. Did you mean `epochs`?"),
        (["dynamics=KBM"], "Did you mean dynamics=kbm"),
        (["EPOCHS=3"], "Did you mean `epochs`?"),
        (["optim.lr=3"], "Did you mean `optim.optimizer.lr`?"),
        (["data=csv", "data.columns.xx=a"], "Did you mean `data.columns.x`?"),
        (["~goall"], "`goall` must be a key of the configuration of train, but got ~goall"),
        (["a=[1"], "`arguments` must read key=value, but got 'a=[1' on the command line. Write"),
        (["+goal=future"], "`goal` must be given once, but got +goal=future on the command line."),
        (["seed=0,1"], "Ambiguous value for argument 'seed=0,1'"),
        (["-m", "seed=0,1", "goal=futur"], "Did you mean goal=future?"),
        (["hydra/launcher=submitit_none"], "pip install 'diffstack_mmv[sweep]'"),
        (["optim.optimizer=[1]"], "`optim.optimizer` must have a value of the kind of its default, "
         "such as settings with their names, but got optim.optimizer=[1] on the command line."),
        (["data.cache=nowhere"], "`cache` must hold a finished conversion of 'thab_vru', but got"),
    ],
)  # fmt: skip
def test_a_refused_command_line_is_told_in_one_line(arguments, told, answer):
    line = answer(*arguments)
    assert told in line
    assert len(line.splitlines()) == 1


def test_a_group_without_a_choice_is_told_with_its_options(monkeypatch, capsys, tmp_path):
    GlobalHydra.instance().clear()
    arguments = ["navigate.py", "scenario=replay", f"out={tmp_path}"]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit):
        navigate()
    GlobalHydra.instance().clear()
    told = capsys.readouterr().err
    assert told.startswith("`data` must be given. Add data=NAME: autobike, citr, ")
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "`runs` must name at least two, but got []. Give folders DIR/episodes/NAME"),
        (["runs=[a,b]", "cases=[3]"], "`runs` must be folders of episodes, but got a. Give"),
        (["runs=[a,b]", "cases=[]"], "`cases` must name at least one, but got []."),
    ],
)
def test_runs_and_cases_that_cannot_be_side_by_side_are_named(
    arguments, told, monkeypatch, capsys, tmp_path
):
    GlobalHydra.instance().clear()
    monkeypatch.setattr(sys, "argv", ["side_by_side.py", *arguments, f"out={tmp_path}"])
    with pytest.raises(SystemExit):
        side_by_side()
    GlobalHydra.instance().clear()
    assert capsys.readouterr().err.startswith(told)


def test_controllers_side_by_side_can_be_told_apart():
    kbm, gm3 = Path("kbm/episodes/diffmpc"), Path("gm3/episodes/diffmpc")
    assert names_of([kbm, Path("kbm/episodes/mppi")]) == ["diffmpc", "mppi"]
    assert names_of([kbm, gm3]) == ["diffmpc in kbm", "diffmpc in gm3"]


def test_drives_of_other_cases_side_by_side_are_refused(monkeypatch, capsys, tmp_path):
    for name, radius in (("one", 4.0), ("two", 5.0)):
        (tmp_path / name).mkdir()
        told = f"phase: test\nscenario: {{humans: 5, circle_radius_m: {radius}}}\n"
        (tmp_path / name / "config.yaml").write_text(told)
    one, two = (tmp_path / name / "episodes" / "mppi" for name in ("one", "two"))
    arguments = [f"runs=[{one},{two}]", "cases=[3]", f"out={tmp_path / 'out'}"]
    GlobalHydra.instance().clear()
    monkeypatch.setattr(sys, "argv", ["side_by_side.py", *arguments])
    with pytest.raises(SystemExit):
        side_by_side()
    GlobalHydra.instance().clear()
    wanted = f"be drives of one scenario.circle_radius_m, 4.0 as in {one}, but got 5.0 in {two}."
    assert f"`runs` must {wanted}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("phase: [", "`runs` must be a YAML file, but got {file}: while parsing"),
        ("seed: 0", "`runs` must be drives, but got no phase and no scenario in {file}. Give"),
        (
            "phase: test\nscenario: {_target_: logging.getLogger}",
            "`_target_` must name what a file may have built, but got 'logging.getLogger' at scena",
        ),
    ],
)
def test_side_by_side_builds_nothing_that_a_drive_of_others_may_not(
    text, told, monkeypatch, capsys, tmp_path
):
    """The folder of a drive may come from somebody else, and Hydra would call any function."""
    file = tmp_path / "config.yaml"
    file.write_text(text)
    runs = ",".join(str(tmp_path / "episodes" / name) for name in ("mppi", "orca"))
    arguments = ["side_by_side.py", f"runs=[{runs}]", "cases=[3]", f"out={tmp_path / 'out'}"]
    GlobalHydra.instance().clear()
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit):
        side_by_side()
    GlobalHydra.instance().clear()
    assert capsys.readouterr().err.startswith(told.format(file=file))


def test_a_job_of_a_sweep_that_fails_is_named(answer):
    lines = answer("-m", "data.cache=nowhere", "seed=0").splitlines()
    assert lines[0].startswith(
        "Error executing job with overrides: ['data.cache=nowhere', 'seed=0'"
    )
    assert lines[1].startswith("`cache` must hold a finished conversion")


def test_the_traceback_is_shown_where_it_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setattr(sys, "argv", ["train.py", "goal=futur", f"out={tmp_path}"])
    with pytest.raises(OSError, match="Could not find 'goal/futur'"):
        main()
    GlobalHydra.instance().clear()
