"""Jobs run side by side, once each, and tell how they ended."""

import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from diffstack_mmv.commands.command_line import quoted
from diffstack_mmv.commands.experiment_jobs import Experiment
from diffstack_mmv.commands.jobs import Job, LocalProcesses, Slurm, run_job
from diffstack_mmv.commands.table_jobs import (
    TableJobs,
    expected_seconds,
    require_same_jobs,
    run_all,
    why_failed,
)
from diffstack_mmv.reporting import Run
from dmmv_conventions.configs import config_folder
from scripts.results import check, judged_data

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def job(folder, name, code):
    """A job that runs a line of Python in which RESULT is its result."""
    result = folder / f"{name}.txt"
    line = code.replace("RESULT", repr(str(result)))
    command = (sys.executable, "-S", "-c", line)
    return Job(name, "kind", (command,), result, folder / f"{name}.log")


WRITE = "open(RESULT, 'w').write('done'); print('said')"


def test_jobs_that_write_their_result_succeed_and_the_others_fail(tmp_path):
    jobs = [job(tmp_path, "good", WRITE), job(tmp_path, "bad", "raise SystemExit(3)")]
    ended = {outcome.job.name: outcome.succeeded for outcome in LocalProcesses(2)(jobs)}
    assert ended == {"good": True, "bad": False}
    assert "said" in jobs[0].log.read_text()
    assert jobs[0].done
    assert not jobs[1].done


def test_what_a_failed_command_leaves_is_kept_but_no_result(tmp_path):
    """Such as the report of a conversion that found nothing to use."""
    refused = job(tmp_path, "refused", f"{WRITE}; raise SystemExit(1)")
    assert not run_job(refused).succeeded
    assert (tmp_path / "failed_refused.txt").read_text() == "done"
    assert run_job(refused._replace(commands=job(tmp_path, "refused", WRITE).commands)).succeeded


def test_a_command_after_a_failed_one_does_not_run(tmp_path):
    bad, good = job(tmp_path, "bad", "raise SystemExit(1)"), job(tmp_path, "good", WRITE)
    both = good._replace(commands=(*bad.commands, *good.commands))
    assert [outcome.succeeded for outcome in LocalProcesses(1)([both])] == [False]


def test_what_is_done_is_not_run_again_and_what_failed_is_told(tmp_path, caplog):
    caplog.set_level("INFO")
    done, good, bad = (
        job(tmp_path, name, code)
        for name, code in (("done", "raise SystemExit(3)"), ("good", WRITE), ("bad", "1 / 0"))
    )
    done.result.touch()
    assert run_all(LocalProcesses(2), [done, good, bad], "table", "drive") == [bad]
    assert "bad: 0 s, FAILED" in caplog.text
    assert "done" not in caplog.text
    assert run_all(LocalProcesses(2), [done, good], "table", "drive") == []


def test_a_table_is_written_with_what_is_lacking_before_the_failure_is_told(tmp_path, caplog):
    caplog.set_level("INFO")
    good, bad = job(tmp_path, "good", WRITE), job(tmp_path, "bad", "1 / 0")
    after = job(tmp_path, "after", WRITE)._replace(needs=(bad.result,))
    table, remarks = TableJobs([[good, bad], [after]], LocalProcesses(1), "table", "drive"), []
    table.tell({"kind": 3600.0})
    assert "3 of 3 drives to do, 1 at a time: about 3.0 hours" in caplog.text
    with pytest.raises(ValueError, match="2 of 3 drives failed or were not begun"):
        table.complete(remarks.extend)
    assert [told.split(":")[0] for told in remarks] == ["bad failed", "after was not begun"]
    why = "ZeroDivisionError: division by zero"
    assert remarks[0] == f"bad failed: see {bad.log}, which ends with: {why}"
    bad.result.touch()
    table.complete(remarks.extend)
    assert after.done
    assert len(remarks) == 2


@pytest.mark.parametrize(("width", "expected"), [(1, 14.0), (2, 7.0), (9, 7.0)])
def test_time_is_told_from_finished_jobs_of_the_kind_and_else_from_the_guess(
    tmp_path, width, expected
):
    jobs = [job(tmp_path, name, WRITE) for name in "abc"]
    jobs[2] = jobs[2]._replace(kind="other")
    jobs[0].result.touch()
    told = json.dumps({"kind": "kind", "seconds": 4.0})
    jobs[0].log.with_suffix(".json").write_text(told)
    assert expected_seconds(jobs, jobs, {"kind": 99.0, "other": 10.0}, width) == expected


def trained(folder, *settings):
    """A job that is done, and how it is asked for with these settings."""
    folder.mkdir(exist_ok=True)
    asked = job(folder, "run", "")._replace(root=folder)
    code = "import sys; open(sys.argv[1][5:-1], 'w').close()"
    command = (sys.executable, "-c", code, f"out={quoted(asked.result)}", *settings)
    return asked._replace(commands=(command,))


def test_a_finished_job_is_that_of_its_settings_alone(tmp_path):
    run_job(trained(tmp_path, "epochs=1", "seed=0"))
    require_same_jobs([trained(tmp_path, "epochs=1", "seed=0")])
    with pytest.raises(
        ValueError, match="of run with another setting than epochs=2, but got"
    ) as no:
        require_same_jobs([trained(tmp_path, "epochs=2", "seed=1")])
    assert f"but got epochs=1 in {tmp_path / 'run.json'}. Give another out=FOLDER" in str(no.value)
    with pytest.raises(ValueError, match="another setting than none, but got seed=0"):
        require_same_jobs([trained(tmp_path, "epochs=1")])
    with pytest.raises(ValueError, match="another setting than in this order"):
        require_same_jobs([trained(tmp_path, "seed=0", "epochs=1")])


def test_a_finished_job_is_that_of_the_files_that_its_settings_name(tmp_path):
    file = tmp_path / "rad (1).yaml"
    file.write_text("mass_kg: 90")
    asked = trained(tmp_path / "out", f"vehicle={quoted(file)}", "epochs=1")
    run_job(asked)
    require_same_jobs([asked])
    file.write_text("mass_kg: 120")
    with pytest.raises(ValueError, match=r"no result of run with another content of vehicle='.*"):
        require_same_jobs([asked])
    told = json.loads(asked.record.read_text())
    asked.record.write_text(json.dumps({key: told[key] for key in ("kind", "commands")}))
    require_same_jobs([asked])


def test_a_file_that_jobs_have_written_may_change(tmp_path):
    asked = trained(tmp_path, f"start='{tmp_path / 'last.ckpt'}'")
    (tmp_path / "last.ckpt").write_text("before")
    run_job(asked)
    (tmp_path / "last.ckpt").write_text("now")
    require_same_jobs([asked])


def test_a_result_of_a_job_whose_launcher_was_killed_is_that_of_its_settings(tmp_path):
    asked = trained(tmp_path, "epochs=1")
    code = "import os, sys; open(sys.argv[1][5:-1], 'w').close(); os.kill(os.getppid(), 9)"
    command = (sys.executable, "-c", code, *asked.commands[0][3:])
    killed = asked._replace(commands=(command,))
    made = repr(killed).replace("PosixPath", "Path")
    imported = "from diffstack_mmv.commands.jobs import Job, run_job"
    line = f"from pathlib import Path; {imported}; run_job({made})"
    subprocess.run([sys.executable, "-c", line], check=False)
    assert killed.done
    with pytest.raises(ValueError, match="another setting than epochs=2, but got epochs=1"):
        require_same_jobs([killed._replace(commands=((*command[:-1], "epochs=2"),))])
    assert expected_seconds([killed], [killed], {}, 1) == 0.0


def test_a_part_of_a_result_is_that_of_its_settings_and_a_failure_without_any_is_none(tmp_path):
    asked = trained(tmp_path, "epochs=1")
    failed = asked._replace(result=tmp_path / "none", partial=tmp_path / "episodes")
    assert not run_job(failed).succeeded
    other = failed._replace(commands=trained(tmp_path, "epochs=2").commands)
    require_same_jobs([other])
    failed.partial.mkdir()
    require_same_jobs([failed])
    with pytest.raises(ValueError, match="another setting than epochs=2, but got epochs=1"):
        require_same_jobs([other])


def test_jobs_are_the_same_wherever_their_folder_was_moved(tmp_path):
    run_job(trained(tmp_path / "here (ü)", "epochs=1"))
    (tmp_path / "here (ü)").rename(tmp_path / "there's")
    require_same_jobs([trained(tmp_path / "there's", "epochs=1")])


def test_a_finished_job_of_before_there_were_records_of_settings_is_done(tmp_path):
    old = trained(tmp_path, "epochs=1")
    old.result.touch()
    require_same_jobs([old])
    old.record.write_text(json.dumps({"kind": "kind", "seconds": 4.0}))
    require_same_jobs([old])


def test_a_table_refuses_results_of_other_settings_and_a_dry_run_writes_none(
    succeed, refusal, tmp_path
):
    out = tmp_path / "ü (1)"
    arguments = [f"raw={tmp_path}", f"out='{out}'", "dry_run=true"]
    succeed("results", *arguments)
    assert not (out / "config.yaml").exists()
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", [*arguments, "size.epochs=7"])
    runs = [run for run in Experiment(config, out, SCRIPTS).runs() if run.data == "sample"]
    made = Experiment(config, out, SCRIPTS).training(runs[0])
    for file in (made.result, made.record):
        file.parent.mkdir(parents=True, exist_ok=True)
    made.result.touch()
    made.record.write_text(json.dumps({"commands": made.settings}))
    told = refusal("results", *arguments)
    assert f"no result of {made.name} with another setting than epochs=" in told
    assert f"but got epochs=7 in {made.record}" in told
    assert f"or delete {made.folder}." in told


@pytest.mark.slow
def test_jobs_run_through_the_launcher_of_clusters(tmp_path):
    pytest.importorskip("submitit", reason="needs the extra `sweep`")
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        given = ["launcher=slurm", "launcher.cluster=local", f"out={tmp_path}"]
        config = compose("results", [*given, "launcher.parameters.timeout_min=1"]).launcher
    jobs = [job(tmp_path, "good", WRITE), job(tmp_path, "bad", "raise SystemExit(3)")]
    ended = {outcome.job.name: outcome.succeeded for outcome in instantiate(config)(jobs)}
    assert ended == {"good": True, "bad": False}
    assert list((tmp_path / "slurm").glob("*_log.out"))


class Submitted:
    """A job of a cluster: one that waits for ever, that the cluster ended, or that succeeded."""

    def __init__(self, run, job):
        self.run, self.job, self.cancelled = run, job, False

    def done(self):
        return self.job.name != "waiting"

    def result(self):
        if self.job.name == "ended":
            raise RuntimeError("Job 7 with path 7.pkl\nhas not produced any output (TIMEOUT)\n...")
        return self.run(self.job)

    def cancel(self, check):
        self.cancelled = True


@pytest.fixture
def cluster(monkeypatch):
    """A stand-in for submitit; what was submitted, and a switch for what it refuses."""
    told = SimpleNamespace(submitted=[], refusal=None)

    def submit(run, jobs):
        if told.refusal is not None:
            raise told.refusal
        told.submitted = [Submitted(run, job) for job in jobs]
        return told.submitted

    executor = SimpleNamespace(update_parameters=lambda **_: None, map_array=submit)
    standin = SimpleNamespace(AutoExecutor=lambda folder, cluster: executor)
    monkeypatch.setitem(sys.modules, "submitit", standin)
    return told


def test_a_job_that_a_cluster_ended_has_failed_and_the_others_go_on(tmp_path, cluster, caplog):
    jobs = [job(tmp_path, name, WRITE) for name in ("ended", "good")]
    launcher = Slurm(str(tmp_path), {}, cluster="slurm")
    assert run_all(launcher, jobs, "table", "job") == jobs[:1]
    assert "ended: Job 7 with path 7.pkl has not produced any output (TIMEOUT)" in caplog.text
    assert jobs[1].done


def test_jobs_of_a_cluster_are_cancelled_where_nobody_waits_for_them_any_more(tmp_path, cluster):
    jobs = [job(tmp_path, name, WRITE) for name in ("waiting", "good")]
    outcomes = Slurm(str(tmp_path), {}, cluster="slurm")(jobs)
    assert next(outcomes).job == jobs[1]
    outcomes.close()
    assert [each.cancelled for each in cluster.submitted] == [True, False]


@pytest.mark.parametrize(
    "refusal",
    [
        RuntimeError("sbatch: error: invalid partition specified: gpu"),
        NameError("Unknown argument 'partitions' for executor 'slurm'"),
    ],
)
def test_what_a_cluster_refuses_is_told_in_one_line(tmp_path, cluster, refusal):
    cluster.refusal = refusal
    told = f"`launcher.parameters` must be what the cluster takes, but got {refusal}"
    with pytest.raises(ValueError, match=re.escape(told)):
        list(Slurm(str(tmp_path), {}, cluster="slurm")([job(tmp_path, "good", WRITE)]))


def test_without_a_cluster_not_all_jobs_are_begun_here_at_once(tmp_path, cluster, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    launcher = Slurm(str(tmp_path), {})
    with pytest.raises(ValueError, match="`launcher` must be slurm where srun is found"):
        list(launcher([job(tmp_path, "good", WRITE)]))
    assert not cluster.submitted


@pytest.mark.parametrize(
    ("pretraining", "jobs"),
    [
        ([], 181),
        (["size.pretraining.dynamics=kbm"], 136),
        (["size.pretraining=null"], 121),
        (["size.ensemble=true"], 181 + 24),
    ],
)
def test_every_model_has_a_pretraining_or_all_share_one(succeed, tmp_path, pretraining, jobs):
    """One conversion, pretrainings for each of 3 modes and 5 seeds, 4 models and 2 goals."""
    arguments = ["size=full", f"raw={tmp_path}", "dry_run=true", f"out={tmp_path / 'out'}"]
    assert f"{jobs} of {jobs} jobs to do" in succeed("results", *arguments, *pretraining)


def test_folders_of_any_name_reach_the_commands(tmp_path):
    out = tmp_path / "Läufe (1), it's"
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", [f"raw={tmp_path}", "size=full"])
        experiment = Experiment(config, out, SCRIPTS)
        run = next(iter(experiment.runs()))
        generate, convert = experiment.conversion("sample").commands
        train, evaluate = experiment.training(run).commands
        told = {
            name: compose(name, list(line[2:]))
            for name, line in {
                "generate_sample": generate, "convert": convert, "train": train,
                "evaluate": evaluate,
            }.items()
        }  # fmt: skip
    assert told["generate_sample"].out == str(out / "data/sample/recordings")
    assert told["convert"].data.root == told["generate_sample"].out
    assert told["train"].data.cache == told["convert"].data.cache
    assert told["train"].start.startswith(str(out / "runs"))
    assert told["evaluate"].checkpoint.startswith(told["train"].out)
    assert told["evaluate"].out == str(run.report)


@pytest.mark.parametrize("seeds", [[3, 1, 2], [3]])
def test_an_ensemble_is_judged_from_the_best_epoch_of_every_seed(tmp_path, seeds):
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        asked = ["experiment=eth_ucy", "size.ensemble=true", f"size.seeds={seeds}"]
        experiment = Experiment(compose("results", asked), tmp_path, SCRIPTS)
        runs = list(experiment.runs())
        ensembles = experiment.ensembles(runs)
        assert len(ensembles) == (len(runs) / 3 if len(seeds) > 1 else 0)
        for run in ensembles:
            assert run.model in experiment.titles
            made = experiment.mixing(run)
            told = compose("evaluate", list(made.commands[0][2:]))
            own = [each for each in runs if each.place == run.place]
            assert [told.checkpoint, *told.ensemble] == [
                str(each.report.parent / "checkpoints" / "best.ckpt") for each in own
            ]
            assert list(made.needs) == [each.metrics for each in own]
            assert made.result == run.metrics
    assert len(experiment.titles) == (2 if len(seeds) > 1 else 1)


def test_sets_and_models_of_null_are_left_out(succeed, tmp_path):
    arguments = ["experiment=eth_ucy", f"raw={tmp_path}", "dry_run=true", f"out={tmp_path / 'out'}"]
    (tmp_path / "eth_ucy").mkdir()
    assert "10 of 10 jobs to do" in succeed("results", *arguments)


def test_figures_show_the_windows_of_the_evaluation_in_the_present_cache(tmp_path):
    """The training may have had others (`overrides`), and results may have been moved since."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        experiment = Experiment(compose("results", []), tmp_path, SCRIPTS)
    run = next(iter(experiment.runs()))
    source = {"_target_": "diffstack_mmv.data.ConvertedCache", "folder": "/before/cache"}
    module = {"source": source, "export": {"folder": "/before/cache/exports"}, "windows": {"a": 1}}
    run.report.mkdir(parents=True)
    (run.report / "config.yaml").write_text(json.dumps({"data": {"module": module}}))
    found, cache = judged_data(experiment, run), tmp_path / "data" / run.data / "cache"
    assert found["source"] == source | {"folder": str(cache)}
    assert (found["export"], found["windows"]) == ({"folder": str(cache / "exports")}, {"a": 1})


def test_modes_of_null_are_left_out(tmp_path):
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", ["sets.sample.modes.scooter=null"])
    runs = Experiment(config, tmp_path, SCRIPTS).runs()
    assert {run.mode for run in runs if run.data == "sample"} == {"bicycle", "motorcycle"}
    check(config)


def test_a_table_all_of_whose_models_are_null_is_refused():
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        names = ("unicycle", "kbm", "gm3", "gm3_paper")
        config = compose("results", [f"models.{name}=null" for name in names])
    with pytest.raises(ValueError, match="`models` must name at least one, but got none"):
        check(config)


def test_sets_that_differ_in_their_training_share_a_conversion(succeed, tmp_path):
    given = ["experiment=predictor_ablation", f"raw={tmp_path}", f"out={tmp_path / 'out'}"]
    (tmp_path / "thab_vru").mkdir()
    arguments = [*given, "size.seeds=[1]", "dry_run=true"]
    told = succeed("results", *arguments)
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", given)
    rows = [name for name, told_of in config.sets.items() if told_of is not None]
    assert f"{len(rows) + 1} of {len(rows) + 1} jobs to do" in told
    run = Run(rows[-1], "bicycle", "kbm", "predicted", 1, tmp_path / "runs/a/report")
    train = Experiment(config, tmp_path, SCRIPTS).training(run).commands[0]
    assert f"data.cache='{tmp_path / 'data' / 'present' / 'cache'}'" in train


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("sets.site.converted=nowhere", "`sets.site.converted` must be one of"),
        ("sets.site.data=sdd", "`sets.site.data` must be that of `sets.present`"),
        ("rows=set", "`rows` must be one of methods, sets"),
        ("plans=true", "`plans` must be false with rows=sets"),
    ],
)
def test_sets_of_other_recordings_and_rows_of_plans_are_refused(setting, told):
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", ["experiment=predictor_ablation", setting])
    with pytest.raises(ValueError, match=told):
        check(config)


def test_a_dry_run_names_the_sets_without_recordings(succeed, tmp_path):
    arguments = ["size=small", f"raw={tmp_path}", "dry_run=true", f"out={tmp_path / 'out'}"]
    told = succeed("results", *arguments)
    assert f"Left out: sdd: no recordings in {tmp_path}" in told


def test_a_table_of_no_recordings_at_all_is_refused(refusal, tmp_path):
    told = refusal("results", "experiment=cyclists", f"raw={tmp_path}", f"out={tmp_path / 'out'}")
    assert f"`raw` must hold recordings of one of thab_vru, but got {tmp_path}" in told
    assert not (tmp_path / "out" / "results.md").exists()


def test_settings_of_a_set_for_its_training_are_given_to_that_alone():
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", ["experiment=shared_space", "raw=recordings", "out=out"])
    run = Run("dut_people", "pedestrian", "kbm", "predicted", 0, Path("out/runs/a/report"))
    train, evaluate = Experiment(config, Path("out"), SCRIPTS).training(run).commands
    assert "predictor=trajectron_pedestrian" in train
    assert not [told for told in evaluate if "predictor" in told or "history_s" in told]
    assert {"data.neighbors=6", "data=dut"} <= set(train) & set(evaluate)


@pytest.mark.parametrize(("name", "epochs"), [("dut_cars", 30), ("dut_people", 16)])
def test_a_setting_of_a_set_goes_before_that_of_all(name, epochs):
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", ["experiment=shared_space", "raw=recordings", "out=out"])
        [mode] = config.sets[name].modes
        run = Run(name, mode, "kbm", "predicted", 0, Path("out/runs/a/report"))
        train, _ = Experiment(config, Path("out"), SCRIPTS).training(run).commands
        assert compose("train", list(train[2:])).epochs == epochs


def test_nothing_begins_whose_predictor_has_weights_but_no_result(tmp_path):
    """As after a kill: the checkpoint of its best epoch so far is there."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("results", ["size=full", f"raw={tmp_path}", f"out={tmp_path}"])
    run = Run("sample", "bicycle", "kbm", "predicted", 1, tmp_path / "runs/a/b/c/d/1/report")
    asked = Experiment(config, tmp_path, SCRIPTS).training(run)
    conversion, predictor = asked.needs
    assert asked.lacking == [conversion, predictor]
    conversion.parent.mkdir(parents=True)
    conversion.touch()
    start = next(told for told in asked.commands[0] if told.startswith("start="))
    weights = Path(start.removeprefix("start=").strip("'"))
    weights.parent.mkdir(parents=True)
    weights.touch()
    assert asked.lacking == [predictor]
    assert run_all(LocalProcesses(1), [asked], "results", "job") == [asked]
    assert f"was not begun: {predictor} is not there" in why_failed(asked)
    assert not asked.log.exists()
