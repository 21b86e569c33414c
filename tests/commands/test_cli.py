"""What all command lines share: complete configurations, files of vehicles, one message."""

import contextlib
import errno
import gc
import logging
import re
import shlex
import sys
import warnings
from io import StringIO
from zipfile import ZipFile

import pytest
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from diffstack_mmv.commands.cli import admit_any, command, save_config
from dmmv_conventions.extras import needs
from dmmv_conventions.locks import alone_in

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
    configs = tmp_path / "configs"
    configs.mkdir()
    (configs / "task.yaml").write_text(CONTENT)
    monkeypatch.chdir(tmp_path)

    def go(*arguments, task=lambda config: None, admit=admit_any):
        seen = []
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["task", *arguments, f"out={tmp_path / 'out'}"])

        def keep(config):
            seen.append(config)
            task(config)

        with contextlib.suppress(SystemExit):
            command(configs, "task", admit)(keep)()
        GlobalHydra.instance().clear()
        return (seen[0] if seen else None), capsys.readouterr().err

    return go


@pytest.mark.parametrize("value", ["${smallest}", "${vehicle}", "${vehicle.name}", "${nothing}"])
def test_a_setting_that_leads_back_to_itself_or_nowhere_is_named(run, value):
    key = "vehicle.name" if "vehicle" in value else "smallest"
    config, told = run("needed=1", f"{key}={value}")
    assert config is None
    assert told.startswith(f"`{key}` must be a value, but got an interpolation that leads to none")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ([], "`needed` must be given. Add needed=VALUE"),
        (["needed=1", "+cache=Läufe(1"], "letters such as ü in quotes"),
        (
            ["needed=1", "+model={_target_: os.system, _args_: [ls]}"],
            "`_target_` must name what a file may have built, but got 'os.system' at model",
        ),
        (
            ["needed=1", "vehicle=nowhere.yaml"],
            "must be a name or an existing YAML file, but got 'nowhere.yaml'",
        ),
    ],
    ids=["not given", "not to be read", "not to be built", "no vehicle"],
)
def test_what_no_task_can_be_run_with_is_told(run, arguments, wanted):
    config, told = run(*arguments)
    assert config is None
    assert wanted in told
    assert "Traceback" not in told


def test_the_search_for_garbage_is_on_during_the_work_and_afterwards(run):
    on = []
    run("needed=1", task=lambda config: on.append(gc.isenabled()))
    assert on == [True]
    assert gc.isenabled()


def test_the_resolved_configuration_is_saved_before_the_work(run, tmp_path):
    def fail(config):
        raise ValueError("`x` must be positive, but got -1.")

    _, told = run("needed=1", task=fail)
    saved = OmegaConf.load(tmp_path / "out" / "config.yaml")
    assert (saved.needed, saved.smallest) == (1, 2)
    assert "`x` must be positive, but got -1." in told


@pytest.mark.parametrize(
    "options",
    [
        ("--cfg", "job"),
        ("-c", "job", "--resolve"),
        ("--cfg=job",),
        ("--config-dir", "more", "--cfg", "job"),
        ("--info",),
        ("--info", "config"),
    ],
)
def test_settings_may_stand_on_both_sides_of_an_option(options, tmp_path, monkeypatch, capsys):
    for folder in ("configs", "more"):
        (tmp_path / folder).mkdir()
    (tmp_path / "configs" / "task.yaml").write_text(CONTENT)
    monkeypatch.chdir(tmp_path)
    GlobalHydra.instance().clear()
    monkeypatch.setattr(sys, "argv", ["task", "needed=1", *options, "out=there"])
    command(tmp_path / "configs", "task")(lambda config: None)()
    shown = capsys.readouterr().out
    assert "needed: 1" in shown
    assert "out: there" in shown


def test_options_that_exclude_each_other_are_told_in_one_line(run):
    config, told = run("needed=1", "-m", "--cfg", "job")
    assert config is None
    assert told.splitlines()[-1].startswith("Only one of --run, --multirun, --cfg, --info")


@pytest.mark.parametrize(("place", "quote"), [("mine.yaml", ""), ("veh dir (ü)/own.yaml", "'")])
def test_a_vehicle_comes_from_a_file(run, tmp_path, place, quote):
    file = tmp_path / place
    file.parent.mkdir(exist_ok=True)
    file.write_text("name: mine\n")
    config, _ = run("needed=1", f"vehicle={quote}{file}{quote}")
    assert config.vehicle == {"name": "mine"}


def test_a_dry_run_leaves_no_configuration(run, tmp_path):
    run("needed=1", "+dry_run=true")
    assert not (tmp_path / "out" / "config.yaml").exists()


def test_the_command_line_changes_the_vehicle_of_a_file(run, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("{name: mine, mass_kg: 90, drag: 1, limits: {speed_mps: 5}}")
    words = "vehicle.mass_kg=200", "+vehicle.limits.steer_rad=1", "~vehicle.drag"
    default = "vehicle={name: bicycle, mass_kg: 80, drag: 2, limits: {}}"
    config, told = run("needed=1", f"+{default}", f"vehicle={file}", *words)
    assert told == ""
    limits = {"speed_mps": 5, "steer_rad": 1}
    assert config.vehicle == {"name": "mine", "mass_kg": 200, "limits": limits}


def test_an_impossible_vehicle_is_told_with_its_file(refusal, root, tmp_path):
    file = tmp_path / "mine.yaml"
    text = (root / "configs/vehicle/bicycle.yaml").read_text()
    file.write_text(re.sub("mass_kg: [0-9.]+", "mass_kg: -5", text, count=1))
    told = refusal("simulate", f"vehicle={file}", f"out={tmp_path / 'out'}")
    assert "`mass_kg` must be positive, but got -5.0 for vehicle 'bicycle'." in told
    assert told.strip().endswith(f"(file {file})")


def wrong_key(config):
    raise KeyError("key")


def lacking(config):
    with needs("dashboard", "the dashboard"):
        import nowhere_to_be_found  # noqa: F401


@pytest.mark.parametrize(
    ("task", "wanted"),
    [
        (wrong_key, "KeyError: 'key'"),
        (lacking, "`nowhere_to_be_found` must be installed for the dashboard"),
    ],
)
def test_a_failure_shows_no_traceback(run, task, wanted):
    _, told = run("needed=1", task=task)
    assert told.startswith(wanted)
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("said", "file", "told"),
    [
        (
            "No space left",
            None,
            "`disk` must have free space, but got No space left at {out}. Free",
        ),
        ("No space left", "here", "`disk` must have free space, but got No space left at here. Fr"),
        ("`folder` must have free disk space.", None, "`folder` must have free disk space.\n"),
    ],
)
def test_a_full_disk_is_told_with_its_place_and_a_remedy(said, file, told, run, tmp_path):
    def fill(config):
        raise OSError(errno.ENOSPC, said, file)

    assert run("needed=1", task=fill)[1].startswith(told.format(out=tmp_path / "out"))


def test_who_interrupts_a_command_sees_no_traceback(run):
    def wait(config):
        raise KeyboardInterrupt

    assert run("needed=1", task=wait)[1] == "Interrupted.\n"


def test_a_file_in_the_place_of_the_folder_is_named(run, tmp_path):
    (tmp_path / "out").write_text("a file")
    config, told = run("needed=1")
    assert config is None
    assert told.startswith("`out` must be a folder that can be written, but got")
    assert str(tmp_path / "out") in told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("out/result", "`out` must be a folder that can be written, but got '{file}' (Permission"),
        ("cache", "`path` must be open to this user, but got '{file}' (Permission denied). Allow"),
    ],
)
def test_a_file_that_may_not_be_touched_is_named(file, told, run, tmp_path):
    def touch(config):
        raise PermissionError(errno.EACCES, "Permission denied", str(tmp_path / file))

    assert run("needed=1", task=touch)[1].startswith(told.format(file=tmp_path / file))


def test_a_log_that_cannot_be_written_is_told_with_its_folder(run, tmp_path):
    (tmp_path / "out" / "task.log").mkdir(parents=True)
    _, told = run("needed=1", "hydra.job.name=task")
    assert told.startswith("`out` must be a folder that can be written, but got")
    assert str(tmp_path / "out" / "task.log") in told


@pytest.mark.parametrize("category", [DeprecationWarning, FutureWarning])
@pytest.mark.parametrize(("options", "shown"), [([], 0), (["default"], 1)])
def test_deprecations_of_packages_are_shown_to_who_asks(run, monkeypatch, category, options, shown):
    monkeypatch.setattr(sys, "warnoptions", options)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run("needed=1", task=lambda config: warnings.warn("old", category, stacklevel=1))
    assert sum(each.category is category for each in caught) == shown


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("GPU available: False, used: False", True),
        ("TPU available: False, using: 0 TPU cores", False),
        ("💡 Tip: For seamless cloud logging, try installing something.", False),
        ("`Trainer(limit_val_batches=1.0)` was configured so 100% of the batches ...", False),
    ],
)
def test_of_lightning_only_what_tells_something_is_logged(run, line, shown):
    logger = logging.getLogger("pytorch_lightning.utilities.rank_zero")
    told = StringIO()

    def log(config):
        handler = logging.StreamHandler(told)
        logger.addHandler(handler)
        logger.error(line)
        logger.removeHandler(handler)

    run("needed=1", task=log)
    assert (line in told.getvalue()) is shown
    assert not logger.filters


def test_a_bug_is_not_hidden_behind_a_message(run):
    def fail(config):
        raise ZeroDivisionError("a bug")

    with pytest.raises(ZeroDivisionError, match="a bug"):
        run("needed=1", task=fail)


def test_a_configuration_is_replaced_whole(tmp_path):
    for value in (1, 2):
        save_config(OmegaConf.create({"value": value}), tmp_path / "config.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]
    assert OmegaConf.load(tmp_path / "config.yaml").value == 2


def test_the_shown_configuration_has_the_vehicle_of_the_file(run, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("name: mine\nmass_kg: 90\n")
    with contextlib.redirect_stdout(StringIO()) as shown:
        run("needed=1", f"vehicle={file}", "vehicle.name=ours", "--cfg", "job", "-p", "vehicle")
    assert shown.getvalue() == "# @package vehicle\nname: ours\nmass_kg: 90\n"


def test_a_missing_vehicle_file_is_named_where_it_would_be_shown(run):
    told = run("needed=1", "vehicle=none.yaml", "--cfg", "job")[1]
    assert told == "`vehicle` must be a name or an existing YAML file, but got 'none.yaml'.\n"


@pytest.mark.parametrize("target", ["os.system", "pathlib.Path.write_text"])
def test_what_a_vehicle_file_would_have_built_is_refused(target, run, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(f"name: mine\nsteering: {{_target_: {target}, _args_: [ls]}}\n")
    config, told = run("needed=1", f"vehicle={file}")
    assert config is None
    assert f"`_target_` must name what a file may have built, but got '{target}'" in told
    assert "Traceback" not in told


def test_the_saved_configuration_begins_with_the_words_of_the_command(run, tmp_path):
    run("needed=1 2")
    first = (tmp_path / "out" / "config.yaml").read_text().splitlines()[0]
    assert shlex.split(first.removeprefix("# ")) == ["needed=1 2", f"out={tmp_path / 'out'}"]


def test_a_saved_configuration_in_place_of_the_own_is_refused(run, tmp_path):
    run("needed=1")
    before = (tmp_path / "out" / "config.yaml").read_text()
    (tmp_path / "saved").mkdir()
    (tmp_path / "saved" / "config.yaml").write_text(before)
    config, told = run("--config-dir", str(tmp_path / "saved"), "--config-name", "config")
    assert config is None
    assert "`config-name` must be task, but got config. To repeat a run" in told


def test_a_refused_run_leaves_the_folder_as_it_is(run, tmp_path):
    def refuse(config):
        if config.needed == 2:
            raise ValueError("`out` must be a new folder")

    run("needed=1", admit=refuse)
    _, told = run("needed=2", admit=refuse)
    assert "`out` must be a new folder" in told
    assert OmegaConf.load(tmp_path / "out" / "config.yaml").needed == 1


def test_a_refused_sample_leaves_the_configuration_of_the_folder(succeed, refusal, tmp_path):
    given = ["sequences=[0]", "duration_s=16.0", f"out={tmp_path}"]
    succeed("generate_sample", *given)
    before = (tmp_path / "config.yaml").read_text()
    assert "`out` must not hold the sequence yet" in refusal("generate_sample", *given, "seed=1")
    assert (tmp_path / "config.yaml").read_text() == before


def test_a_refused_drive_leaves_the_configuration_of_the_folder(succeed, refusal, tmp_path):
    given = ["controller=straight", "beside=[]", "cases=1", "limit_s=1", "search=null", "animate=0"]
    given.append("wandb=none")
    succeed("navigate", *given, f"out={tmp_path}")
    before = (tmp_path / "config.yaml").read_text()
    told = refusal("navigate", *given, "scenario.humans=3", f"out={tmp_path}")
    assert "`out` must hold episodes of the same settings" in told
    assert (tmp_path / "config.yaml").read_text() == before


def test_two_commands_never_share_a_folder(run, tmp_path):
    with alone_in(tmp_path / "out", "out"):
        config, told = run("needed=1")
    assert config is None
    assert "`out` must be a folder that no other process writes to" in told
    assert run("needed=1")[0] is not None


def test_a_drive_whose_film_nothing_can_write_is_not_begun(refusal, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # as if it was not installed
    told = refusal("navigate", "movie=mp4", "controller=straight", f"out={tmp_path}")
    assert told.startswith("`imageio_ffmpeg` must be installed for moving pictures as MP4")
    assert not (tmp_path / "episodes").exists()


def test_a_training_by_reinforcement_names_the_extra_that_it_needs(refusal, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)  # as if it was not installed
    monkeypatch.delitem(sys.modules, "diffstack_mmv.simulation.reinforcement", raising=False)
    told = refusal("train_policy", f"out={tmp_path / 'policy'}")
    assert told.startswith("`stable_baselines3` must be installed")
    assert "diffstack_mmv[rl]" in told
    with ZipFile(tmp_path / "policy.zip", "w"):
        policy = f"policy={tmp_path / 'policy.zip'}"
    # before any baseline has driven
    told = refusal("navigate", "controller=ppo", policy, f"out={tmp_path / 'drive'}")
    assert told.startswith("`stable_baselines3` must be installed")
    assert not (tmp_path / "drive" / "episodes").exists()


@pytest.mark.parametrize(
    "arguments", [("-m", "needed=1"), ("needed=1", "-m"), ("needed=1", "--multirun")]
)
def test_a_sweep_may_be_asked_for_anywhere(run, arguments):
    config, told = run(*arguments)
    assert config is not None, told
    assert config.needed == 1


def test_a_sweep_without_a_folder_gets_one_of_its_own(tmp_path, monkeypatch):
    """Hydra resolves the folder of a sweep before it knows the name of the command."""
    configs = tmp_path / "configs"
    configs.mkdir()
    sweep = 'hydra: {sweep: {dir: "${out}", subdir: "${hydra:job.num}"}, '
    named = CONTENT.replace("out: out", "out: outputs/${hydra:job.name}").replace("hydra: {", sweep)
    (configs / "task.yaml").write_text(named)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["task", "-m", "needed=1,2"])
    GlobalHydra.instance().clear()
    seen = []
    command(configs, "task")(lambda config: seen.append(config.out))()
    GlobalHydra.instance().clear()
    assert [folder.split("/")[-4:-2] for folder in seen] == [["outputs", "task"]] * 2
    assert [folder.split("/")[-1] for folder in seen] == ["0", "1"]


@pytest.mark.parametrize(("failure", "begun"), [(InterruptedError, [1]), (ValueError, [1, 2])])
def test_a_job_that_is_told_to_end_takes_the_sweep_with_it(failure, begun, run):
    """A failed one lets the others go on."""
    seen = []

    def end(config):
        seen.append(config.needed)
        raise failure("`out` must be told, but got nothing.")

    _, told = run("-m", "needed=1,2", task=end)
    assert seen == begun
    assert "`out` must be told" in told


@pytest.mark.parametrize("rank", ["LOCAL_RANK", "RANK", "SLURM_PROCID"])
def test_of_processes_that_are_told_to_end_together_the_first_alone_tells_it(
    tmp_path, monkeypatch, capsys, rank
):
    """A failed one would have the first killed while it puts its things in order."""

    def end(config):
        raise InterruptedError("Stopped by SIGTERM.")

    (tmp_path / "task.yaml").write_text(CONTENT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["task", "needed=1"])
    for number, status in (("0", 1), ("1", 0)):
        monkeypatch.setenv(rank, number)
        GlobalHydra.instance().clear()
        with pytest.raises(SystemExit) as ended:
            command(tmp_path, "task")(end)()
        assert ended.value.code == status
        assert ("Stopped by SIGTERM." in capsys.readouterr().err) == (status == 1)
    GlobalHydra.instance().clear()
