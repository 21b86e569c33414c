"""The command lines, from recordings to a table, as a user runs them."""

import hashlib
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf

from data_converters import CausalSmoother, Unsmoothed, generate_sample
from diffstack_mmv.data import ConvertedCache, RecordedScenes
from diffstack_mmv.simulation import (
    ExactVerdict,
    HolonomicRobot,
    OrcaPolicy,
    RecordedCrossing,
    ReplayCrowd,
    World,
    drive,
)
from diffstack_mmv.stack import learned_from
from diffstack_mmv.types import Mode
from tests.data.conftest import ToyAgent, write_cache
from tests.running import run_here

ROOT = Path(__file__).resolve().parents[1]
# how riders act is given: finding it takes most of the time of an identification
RIDER = ("tracking.jerk_mps3=2.0", "tracking.curvature_rate=0.4", "starts=1")
MEASURED = (*RIDER, "dynamics=kbm", "heldout=2", "controls={acceleration: 0.1, steer: 0.002}")
# small enough for seconds: everything is there, nothing is trained to any purpose
SMALL = (
    "modes=[bicycle,scooter,motorcycle]",
    "shared_vehicle=true",
    "predictor.components=3",
    "predictor.neighbor_components=1",
    "trainer.limit_train_batches=2",
    "trainer.limit_val_batches=1",
    "trainer.log_every_n_steps=1",
    "batch_size=8",
    "data.module.export.workers=0",
)


def run_alone(script, *arguments):
    """Run a command of scripts/ in a process of its own, which must succeed."""
    command = [sys.executable, str(ROOT / "scripts" / f"{script}.py"), *arguments]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "WANDB_SILENT": "true"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    """Recordings of three sequences, their cache, a trained run and its report."""
    place = tmp_path_factory.mktemp("end_to_end")
    generate_sample(place / "recordings", seed=1, sequences=(0, 50, 200), duration_s=16.0)
    data = ["data=imptc", f"data.cache={place / 'cache'}"]
    root = f"data.root={place / 'recordings'}"
    assert run_here("convert", *data, root, "workers=1", f"out={place / 'conversion'}") == 0
    small = [*SMALL, "dynamics=kbm", "epochs=1"]
    assert run_here("train", *data, *small, f"out={place / 'run'}") == 0
    checkpoint = f"checkpoint={place / 'run' / 'checkpoints' / 'best.ckpt'}"
    report = "data.module.export.workers=0", f"out={place / 'report'}"
    assert run_here("evaluate", checkpoint, *data, *report) == 0
    return place


def data_of(place):
    return ["data=imptc", f"data.cache={place / 'cache'}"]


def test_run_folder_holds_what_a_repetition_needs(workplace):
    run_folder = workplace / "run"
    assert (run_folder / "config.yaml").is_file()
    assert {"best.ckpt", "last.ckpt"} <= {
        path.name for path in (run_folder / "checkpoints").iterdir()
    }
    assert list((run_folder / "wandb").glob("offline-run-*"))
    provenance = torch.load(run_folder / "checkpoints" / "last.ckpt", weights_only=True)[
        "provenance"
    ]
    assert provenance["config"]["seed"] == 0
    assert provenance["commit"]
    scenes = ConvertedCache("imptc", str(workplace / "cache")).scenes()
    assert provenance["data"] == {"imptc": [s["name"] for s in scenes if s["split"] == "train"]}


def test_training_logs_parts_modes_and_learned_parameters(workplace):
    columns = set(pd.read_csv(workplace / "run" / "csv" / "metrics.csv").columns)
    expected = {
        "train/prediction",
        "train/planning_ce",
        "train/control",
        "val/plan_ade",
        "val/solved",
    }
    assert expected <= columns
    assert {"physical/wheelbase", "cost_weight/final_goal", "gradient/predictor"} <= columns
    assert "throughput/samples_per_s" in columns


def test_report_has_a_row_per_mode_beside_the_baselines(workplace):
    metrics = json.loads((workplace / "report" / "metrics.json").read_text())
    assert {"bicycle", "scooter", "motorcycle"} >= set(metrics["modes"])
    assert metrics["modes"]
    assert metrics["goal"] == "predicted"
    assert metrics["modes_of_other_vehicles"] == ["scooter", "motorcycle"]
    assert "are driven with the vehicle bicycle" in (workplace / "report/metrics.md").read_text()
    for name in ("stand_still", "constant_velocity", "kalman", "ctra"):
        assert set(metrics["baselines"][name]) == set(metrics["modes"])
    checkpoint = (workplace / "run" / "checkpoints" / "best.ckpt").read_bytes()
    assert metrics["checkpoint_sha256"] == hashlib.sha256(checkpoint).hexdigest()
    assert len(metrics["data_sha256"]) == 64
    samples = pd.read_parquet(workplace / "report" / "samples.parquet")
    assert len(samples) == sum(scores["n"] for scores in metrics["modes"].values())
    assert (workplace / "report" / "error_over_horizon.png").stat().st_size > 1000


def test_evaluation_is_deterministic(succeed, workplace, tmp_path):
    checkpoint = f"checkpoint={workplace / 'run' / 'checkpoints' / 'best.ckpt'}"
    earlier = [tmp_path / name for name in ("plans_unicycle.png", "scenes.json", "reliability.png")]
    for file in earlier:
        file.touch()
    succeed("evaluate", checkpoint, *data_of(workplace), "plots=false", f"out={tmp_path}")
    assert not [file for file in earlier if file.exists()], "of an earlier evaluation"
    again = json.loads((tmp_path / "metrics.json").read_text())
    before = json.loads((workplace / "report" / "metrics.json").read_text())
    assert again["modes"] == before["modes"]
    assert again["baselines"] == before["baselines"]


@pytest.mark.slow
def test_recordings_of_the_training_are_judged_only_where_that_is_meant(
    refusal, succeed, workplace, tmp_path
):
    checkpoint = f"checkpoint={workplace / 'run' / 'checkpoints' / 'best.ckpt'}"
    arguments = [checkpoint, *data_of(workplace), "split=all", "plans=false", "plots=false"]
    (name,) = learned_from(workplace / "run" / "checkpoints" / "best.ckpt")["imptc"]
    told = refusal("evaluate", *arguments, f"out={tmp_path / 'refused'}")
    assert f"1 of them in 'all': imptc/{name}. " in told
    succeed("evaluate", *arguments, "allow_seen=true", f"out={tmp_path / 'allowed'}")
    metrics = json.loads((tmp_path / "allowed" / "metrics.json").read_text())
    assert metrics["seen_in_training"] == 1
    before = json.loads((workplace / "report" / "metrics.json").read_text())
    assert before["seen_in_training"] == 0


def test_an_ensemble_of_equals_predicts_as_one_of_them(succeed, workplace, tmp_path):
    file = workplace / "run" / "checkpoints" / "best.ckpt"
    told = f"checkpoint={file}", f"ensemble=['{file}']", "plans=false", "plots=false"
    succeed("evaluate", *told, *data_of(workplace), f"out={tmp_path}")
    mixed = json.loads((tmp_path / "metrics.json").read_text())
    alone = json.loads((workplace / "report" / "metrics.json").read_text())
    assert mixed["ensemble"] == [str(file)]
    assert mixed["ensemble_sha256"] == [alone["checkpoint_sha256"]]
    for mode, scores in alone["modes"].items():
        for name in ("median_ade", "nll"):
            assert mixed["modes"][mode][name] == pytest.approx(scores[name], rel=1e-4)


def test_a_report_tells_which_way_its_plans_take_to_a_given_goal(
    succeed, refusal, workplace, tmp_path
):
    checkpoint = f"checkpoint={workplace / 'run' / 'checkpoints' / 'best.ckpt'}"
    asked = checkpoint, *data_of(workplace), "plans=false", "plots=false", f"out={tmp_path}"
    succeed("evaluate", *asked, "goal=future", "goal.steadiness=0.3")
    assert json.loads((tmp_path / "metrics.json").read_text())["steadiness"] == 0.3
    told = refusal("evaluate", *asked, "goal=future")
    assert "`out` must hold no report with another steadiness than 0.15, but got 0.3" in told
    unaimed = json.loads((workplace / "report" / "metrics.json").read_text())
    assert unaimed["steadiness"] is None


def test_a_refused_evaluation_leaves_the_configuration_of_the_folder(refusal, workplace):
    checkpoint = f"checkpoint={workplace / 'run' / 'checkpoints' / 'best.ckpt'}"
    arguments, report = [checkpoint, *data_of(workplace)], workplace / "report"
    before = (report / "config.yaml").read_text()
    told = refusal("evaluate", *arguments, "split=val", f"out={report}")
    assert "`out` must hold no report with another split than val" in told
    told = refusal("evaluate", *arguments, f"out={workplace / 'run'}")
    assert "`out` must hold results of evaluate alone, but got checkpoints/last.ckpt" in told
    assert (report / "config.yaml").read_text() == before


def test_runs_are_compared_in_one_table(succeed, workplace, tmp_path):
    report = workplace / "report"
    succeed("compare", f"runs=[{report}]", f"out={tmp_path}")
    assert "kbm" in (tmp_path / "table.md").read_text()
    assert (tmp_path / "table.tex").is_file()


@pytest.mark.slow
def test_an_evaluation_that_ends_while_it_draws_is_not_taken_for_finished(
    refusal, workplace, tmp_path, monkeypatch
):
    """Tables of many runs go by `metrics.json`, and would leave the drawings out for good."""

    def fail(*_):
        raise OSError("no more drawings")

    monkeypatch.setattr("diffstack_mmv.plotting.save_evaluation", fail)
    checkpoint = f"checkpoint={workplace / 'run' / 'checkpoints' / 'best.ckpt'}"
    options = ["plans=false", "baselines.simple={}", "wandb=none"]
    told = refusal("evaluate", checkpoint, *data_of(workplace), *options, f"out={tmp_path}")
    assert "no more drawings" in told
    assert not (tmp_path / "metrics.json").exists()
    assert (tmp_path / "samples.parquet").is_file()


def test_identification_calibrates_a_vehicle_that_other_commands_accept(
    succeed, workplace, tmp_path
):
    options = ["dynamics=kbm", "tracks=3", "heldout=2", "stretch.max_s=4.0", "others.unicycle=null"]
    succeed(
        "identify", *data_of(workplace), *options, *RIDER, "profile=[wheelbase]", f"out={tmp_path}"
    )
    result = json.loads((tmp_path / "identification.json").read_text())
    assert result["tracks"] == 3
    assert "were asked for" not in (tmp_path / "identify.log").read_text()
    assert {"loss_before", "loss_after", "heldout_before", "heldout_after"} <= set(result)
    assert result["parameters"]["wheelbase"]["verdict"] == "not identifiable"
    assert {"tracks.png", "controls.png", "parameters.png", "spectrum.png", "profiles.png"} <= {
        path.name for path in tmp_path.iterdir()
    }
    calibrated = f"vehicle={tmp_path / 'vehicle.yaml'}"
    succeed("simulate", calibrated, "dynamics=kbm", "others.unicycle=null", f"out={tmp_path / 's'}")


def circles_in(folder, agents, smoother):
    """A cache of circles with the steering of a wheelbase of 1.1 m beside them."""
    scenes = {agent.name: ("train", [agent]) for agent in agents}
    write_cache(folder, scenes, "thab_vru")
    state = folder / "thab_vru" / "cache.json"
    state.write_text(json.dumps(json.loads(state.read_text()) | {"smoother": smoother.settings()}))
    for agent in agents:
        steer = math.atan(1.1 * agent.yaw_rate / agent.speed)
        rows = {"agent_id": agent.name, "time_s": [0.0, 9.0], "acceleration": 0.0, "steer": steer}
        pd.DataFrame(rows).to_parquet(folder / "thab_vru" / agent.name / "controls.parquet")
    return [f"data.cache={folder}", "data=thab_vru", "noise={along_m: 0.02, across_m: 0.02}"]


@pytest.fixture
def circles(tmp_path):
    """Circles at steady speed as they are."""
    turns = (0.3, -0.4, 0.5, -0.6, 0.45, -0.35)
    agents = [
        ToyAgent(f"rider_{number}", Mode.BICYCLE, 60, yaw_rate=turn)
        for number, turn in enumerate(turns)
    ]
    return circles_in(tmp_path, agents, Unsmoothed())


class SmoothedAgent(ToyAgent):
    """An agent on a circle as the causal smoother leaves it."""

    def table(self):
        """See `ToyAgent`; the first rows are its warm-up."""
        rows = replace(self, first=0, rows=self.first + self.rows)
        table = ToyAgent.table(rows)
        time_s = 0.1 * table["scene_ts"].to_numpy()
        smooth = CausalSmoother()(time_s, table[["x", "y"]].to_numpy(), time_s)
        table[["x", "y"]], table[["vx", "vy"]] = smooth.value, smooth.rate
        return table[self.first :]


def test_recorded_controls_tell_the_wheelbase(succeed, circles, tmp_path):
    succeed("identify", *circles, *MEASURED, "tracks=9", f"out={tmp_path / 'out'}")
    told = (tmp_path / "out" / "identify.log").read_text()
    assert "5 tracks were fitted, 9 were asked for." in told
    result = json.loads((tmp_path / "out" / "identification.json").read_text())
    wheelbase = result["parameters"]["wheelbase"]
    assert wheelbase["estimate"] == pytest.approx(1.1, rel=0.01)
    assert wheelbase["verdict"] == "identifiable"
    assert set(result["models"]) == {"kbm"}


def test_the_lag_of_a_smoother_is_undone_beside_recorded_controls(succeed, tmp_path):
    """On circles this tight it would lengthen the wheelbase by several per cent."""
    turns = (1.5, -1.8, 1.6, -1.4)
    agents = [
        SmoothedAgent(f"rider_{number}", Mode.BICYCLE, 60, first=6, yaw_rate=turn)
        for number, turn in enumerate(turns)
    ]
    tight = circles_in(tmp_path, agents, CausalSmoother())
    succeed("identify", *tight, *MEASURED, "tracks=3", f"out={tmp_path / 'out'}")
    result = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert result["parameters"]["wheelbase"]["estimate"] == pytest.approx(1.1, rel=0.01)
    assert "the lag of the smoother was undone" in result["remarks"][-1]
    assert result["smoother"] == "CausalSmoother, looks 0 s ahead"


def test_controls_of_another_model_are_refused(refusal, circles, tmp_path):
    told = refusal("identify", *circles, "dynamics=kbm", "controls={steer: 0.1}", f"out={tmp_path}")
    assert "`controls` must name acceleration, steer in this order, but got steer" in told


@pytest.mark.slow
def test_resumed_run_ends_where_an_uninterrupted_one_does(workplace, tmp_path):
    options = [*data_of(workplace), *SMALL, "logger=csv", "optim.scheduler.T_max=2"]
    run_alone("train", *options, "epochs=2", f"out={tmp_path / 'whole'}")
    run_alone("train", *options, "epochs=1", f"out={tmp_path / 'parts'}")
    run_alone("train", *options, "epochs=2", f"out={tmp_path / 'parts'}")
    whole, parts = (
        torch.load(tmp_path / name / "checkpoints" / "last.ckpt", weights_only=True)
        for name in ("whole", "parts")
    )
    assert whole["global_step"] == parts["global_step"] == 4
    for name, value in whole["state_dict"].items():
        assert torch.equal(value, parts["state_dict"][name]), name
    one, two = (
        pd.read_csv(tmp_path / name / "csv" / "metrics.csv").filter(regex="^(?!throughput)")
        for name in ("whole", "parts")
    )
    pd.testing.assert_frame_equal(one, two)


@pytest.mark.parametrize(
    ("script", "arguments", "told"),
    [
        ("train", ["dynamics=car"], "`dynamics` must be one of gm3,"),
        ("train", ["vehicle=hovercraft"], "but got 'hovercraft' on the command line"),
        ("train", ["vehicle=none.yaml"], "`vehicle` must be a name or an existing YAML file"),
        ("train", ["modes=[bike]"], "`modes` must be one of"),
        ("train", ["modes=[bicycle,scooter]"], "`modes` must be the mode of the vehicle 'bicycle'"),
        ("train", ["horizon_s=2.95"], "`horizon_s` must be a multiple of 0.1"),
        ("train", ["data.cache=nowhere"], "hold a finished conversion"),
        ("train", ["cost.weights.final_goal=-1"], "`weights.final_goal` must be positive"),
        ("evaluate", ["checkpoint=none.ckpt"], "`checkpoint` must be an existing file"),
        ("evaluate", [], "`checkpoint` must be given"),
        ("evaluate", ["checkpoint=README.md"], "`checkpoint` must be readable"),
        ("convert", ["data.root=nowhere"], "nowhere"),
        ("compare", ["runs=[]"], "`runs` must name at least one folder"),
        ("compare", ["runs=reports"], "`runs` must be a list, but got 'reports'. Write runs=[re"),
        ("identify", ["vehicle=skateboard"], "`mode` must have tracks"),
        ("identify", ["controls=measured", "tracks=3"], "Leave out tracks, or controls=measured."),
        ("identify", ["dynamics=kbm", "parameters=[grip]"], "must be one of wheelbase, but got"),
        ("identify", ["dynamics=kbm", "profile=[grip]"], "`profile` must be one of wheelbase"),
        ("identify", ["stretch.min_s=90", "stretch.max_s=90"], "`tracks` must hold a segment"),
    ],
)
def test_bad_input_ends_with_one_message(refusal, script, arguments, told, workplace, tmp_path):
    data = [] if script == "compare" else data_of(workplace)
    assert told in refusal(script, *data, *arguments, f"out={tmp_path}")


def test_what_is_wrong_with_the_data_is_told_before_there_are_more_processes(
    refusal, workplace, tmp_path
):
    ddp = ["trainer=ddp", "trainer.accelerator=cpu", "trainer.devices=2"]
    out = f"out={tmp_path}"
    told = refusal("train", *data_of(workplace), *SMALL, *ddp, "data.sequences=[nobody]", out)
    assert "`sequences` must name scenes" in told
    assert "distributed" not in (tmp_path / "train.log").read_text()


def test_other_run_in_the_same_folder_is_refused_and_left_alone(refusal, workplace):
    last = workplace / "run" / "checkpoints" / "last.ckpt"
    config = (workplace / "run" / "config.yaml").read_bytes()
    before = last.read_bytes()
    message = refusal(
        "train", *data_of(workplace), *SMALL, "dynamics=unicycle", f"out={workplace / 'run'}"
    )
    assert "`out` must be a new folder" in message
    assert last.read_bytes() == before
    assert (workplace / "run" / "config.yaml").read_bytes() == config


@pytest.mark.slow
def test_training_starts_from_the_predictor_of_other_dynamics(succeed, workplace, tmp_path):
    start = workplace / "run" / "checkpoints" / "last.ckpt"
    options = [*SMALL, "dynamics=unicycle", "loss=prediction", "trainer.limit_train_batches=1"]
    succeed("train", *data_of(workplace), *options, f"start={start}", f"out={tmp_path}")
    assert "keep their initial values" in (tmp_path / "train.log").read_text()
    assert learned_from(tmp_path / "checkpoints" / "last.ckpt") == learned_from(start)


def test_checkpoint_of_another_architecture_is_refused(refusal, workplace, tmp_path):
    start = f"start={workplace / 'run' / 'checkpoints' / 'last.ckpt'}"
    message = refusal(
        "train", *data_of(workplace), "predictor.components=7", start, f"out={tmp_path}"
    )
    assert "`checkpoint` must fit the architecture" in message
    assert "predictor.components 3 there, 7 here" in message


@pytest.mark.parametrize(
    "script",
    ["train", "evaluate", "convert", "compare", "identify", "generate_sample", "download_imptc"],
)
def test_help_shows_an_example(succeed, script):
    assert f"python scripts/{script}.py" in succeed(script, "--help")


@pytest.mark.slow
def test_runs_of_a_sweep_train_in_two_processes_each(workplace, tmp_path):
    options = [*data_of(workplace), *SMALL, "logger=csv", "epochs=1", "loss=prediction"]
    ddp = ["trainer=ddp", "trainer.accelerator=cpu", "trainer.devices=2", "optim=adamw_scaled"]
    run_alone("train", "-m", *options, *ddp, "seed=0,1", f"out={tmp_path}")
    for job in ("0", "1"):
        assert (tmp_path / job / "checkpoints" / "best.ckpt").is_file()
        assert OmegaConf.load(tmp_path / job / "config.yaml").seed == int(job)


@pytest.mark.slow
def test_two_processes_score_as_one(workplace, tmp_path):
    options = [
        *data_of(workplace),
        *SMALL,
        "logger=csv",
        "epochs=1",
        "trainer.limit_train_batches=1",
    ]
    options += [
        "trainer.limit_val_batches=1.0",
        "optim.optimizer.lr=0.0",
        "callbacks.early_stopping=null",
    ]
    ddp = ["trainer=ddp", "trainer.accelerator=cpu", "trainer.devices=2"]
    run_alone("train", *options, f"out={tmp_path / 'one'}")
    run_alone("train", *ddp, *options, f"out={tmp_path / 'two'}")
    one, two = (
        pd.read_csv(tmp_path / name / "csv" / "metrics.csv")
        .filter(like="val/")
        .dropna(how="all")
        .iloc[-1]
        for name in ("one", "two")
    )
    pd.testing.assert_series_equal(one, two, check_names=False, rtol=1e-5)


def test_a_vehicle_can_cross_the_people_of_the_sample(workplace):
    scenes = RecordedScenes(ConvertedCache("imptc", str(workplace / "cache")))
    world = World(HolonomicRobot(), ReplayCrowd(), ExactVerdict(8.0))
    scenario = RecordedCrossing(scenes, history_s=2.0, limit_s=8.0, met=1, blind_mps=0.0)
    record = drive(world, scenario.cases("train", [0, 1]), OrcaPolicy()).record
    assert record.pedestrians.isfinite().any()
    assert (record.steps > 0).all()
