"""Results and checkpoints in offline W&B runs, which need neither account nor network."""

import time

import pytest
import pytorch_lightning as pl
import wandb
import yaml
from hydra import compose, initialize_config_dir
from wandb.sdk.lib import console_capture

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.callbacks import CheckpointArtifact, QuietWandbLogger, WandbResults
from diffstack_mmv.reporting.html import read_record
from tests.reporting.html import runs


@pytest.fixture
def offline(monkeypatch):
    """The tests log nothing to W&B; those of the logging do, in a session of their own."""
    # one that an earlier test began keeps the environment of then, and warns
    wandb.teardown()
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")


def tables_of(folder):
    """Names of the tables of an offline run."""
    files = folder.glob("wandb/offline-run-*/files/media/table/**/*.json")
    return {file.name.split("_0_")[0] for file in files}


def written(folder, wanted):
    """The stored record of an offline run, which its own process writes after the run is closed."""
    [file] = folder.glob("wandb/offline-run-*/*.wandb")
    end = time.monotonic() + 20
    while wanted not in file.read_bytes() and time.monotonic() < end:
        time.sleep(0.05)
    return file.read_bytes()


@pytest.mark.parametrize(
    ("kind", "table", "number"),
    [
        (runs.evaluation, "Scores by mode", b"plan_ade"),
        (runs.drive, "Scores", b"success_rate"),
        (runs.identification, "Parameters", b"identifiability"),
        (runs.comparison, "Comparison", b"tables/Comparison"),
    ],
)
def test_tables_and_numbers_of_every_command_are_logged(offline, kind, table, number, tmp_path):
    folder = kind(tmp_path / "run")
    WandbResults(str(folder), "project", "kind")(read_record(folder, runs.TITLES))
    assert table in tables_of(folder)
    assert number in written(folder, number)


def test_columns_of_numbers_are_numbers(tmp_path):
    record = read_record(runs.evaluation(tmp_path / "run"), runs.TITLES)
    table = record.tables["Scores by mode"]
    first = dict(zip(table.columns, table.rows[0], strict=True))
    assert (first["mode"], first["n"]) == ("bicycle", 40.0)
    assert isinstance(first["ADE [m]"], float)
    assert record.numbers["modes/bicycle/n"] == 40.0
    assert record.pictures.keys() == {"plans_bicycle"}


def test_nothing_is_logged_where_the_environment_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "disabled")
    folder = runs.comparison(tmp_path / "run")
    WandbResults(str(folder), "project", "compare")(read_record(folder, runs.TITLES))
    assert not (folder / "wandb").exists()


def test_checkpoints_become_artifacts_of_an_offline_run(offline, tmp_path, capfd):
    (tmp_path / "best.ckpt").write_bytes(b"weights")
    logger = QuietWandbLogger(project="project", save_dir=str(tmp_path), offline=True)
    trainer = pl.Trainer(logger=logger, accelerator="cpu", enable_checkpointing=False)
    CheckpointArtifact(str(tmp_path)).on_fit_end(trainer, pl.LightningModule())
    logger.finalize("success")
    assert "WARNING" not in capfd.readouterr().err
    record = written(tmp_path, b"best.ckpt")
    assert b"best.ckpt" in record
    assert b"last.ckpt" not in record


@pytest.mark.parametrize("status", ["success", "failed"])
def test_every_training_of_a_process_has_a_run_of_its_own(offline, status, tmp_path):
    names = []
    for seed in ("0", "1"):
        logger = QuietWandbLogger(project="project", save_dir=tmp_path, name=seed, offline=True)
        names.append(logger.experiment.name)
        logger.finalize(status)
        assert wandb.run is None
        assert not console_capture._stderr_callbacks  # what the process writes later is not its own
    assert names == ["0", "1"]
    assert len(list(tmp_path.glob("wandb/offline-run-*"))) == 2


def test_the_sweep_of_the_documentation_names_settings_that_exist(root):
    sweep = yaml.safe_load((root / "docs" / "examples" / "wandb_sweep.yaml").read_text())
    values = {
        name: told.get("values", [told.get("max")])[-1]
        for name, told in sweep["parameters"].items()
    }
    fixed = [each for each in sweep["command"] if "=" in each]
    given = [*fixed, *(f"{name}={value}" for name, value in values.items())]
    with initialize_config_dir(str(root / "configs"), version_base="1.3"):
        config = compose("train", given)
    assert config.watched == sweep["metric"]["name"]
    assert config.optim.optimizer.lr == 0.01
    assert (root / sweep["program"]).is_file()
