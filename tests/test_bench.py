"""The list of all benchmarks: what is told before, what is resumed, what is marked."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
spec = importlib.util.spec_from_file_location("run_all", ROOT / "benchmarks" / "run_all.py")
run_all = importlib.util.module_from_spec(spec)
spec.loader.exec_module(run_all)
import load  # noqa: E402, beside it


def test_the_plan_tells_times_and_what_is_missing_and_leaves_out_what_is_done(capsys):
    jobs = [
        run_all.Job("first", 2, ("first.py",)),
        run_all.Job("second", 3, ("second.py",), better_with=("no_such_package",)),
        run_all.Job("third", 4, ("third.py",), ("no_such_package",)),
    ]
    ready = run_all.plan(jobs, {"first": "2026-01-01 12:00"})
    told = capsys.readouterr().out
    assert [job.name for job in ready] == ["second"]
    assert "first            done 2026-01-01 12:00" in told
    assert "about 3 min; rows named as absent: no_such_package" in told
    assert "skipped, not there: no_such_package" in told
    assert "1 to run, about 3 min" in told


@pytest.mark.parametrize(("loads", "marked"), [([1.0, 1.0], False), ([1.0, 5.0], True)])
def test_a_table_that_other_work_disturbed_says_so(loads, marked):
    assert ("Measured under load" in load.remark(sum(loads) / len(loads))) == marked


def test_every_benchmark_of_the_list_exists():
    scripts = [job.command[0] for job in run_all.JOBS if job.command[0] != "-m"]
    assert all((ROOT / script).is_file() for script in scripts)


@pytest.mark.parametrize(("size", "minutes", "more"), [("full", 9, ()), ("small", 2, ("--few",))])
def test_a_size_has_its_own_arguments_and_folder(size, minutes, more):
    job = run_all.of_size(run_all.Job("any", 9, ("any.py",), small=(2, ("--few",))), size)
    assert (job.minutes, job.command) == (minutes, ("any.py", *more))
    assert (run_all.folder_of(size) == run_all.RESULTS) == (size == "full")


def test_the_small_size_takes_less_than_half_an_hour():
    jobs = [run_all.of_size(job, "small") for job in run_all.JOBS]
    assert sum(job.minutes for job in jobs) < 30


def test_what_was_interrupted_goes_on_where_it_was(monkeypatch, tmp_path, capsys):
    names, ran = ("first", "second", "third"), []
    jobs = tuple(run_all.Job(name, 1, (f"{name}.py",)) for name in names)
    for name, value in (("JOBS", jobs), ("KEPT", tmp_path), ("RESULTS", tmp_path / "full")):
        monkeypatch.setattr(run_all, name, value)
    monkeypatch.setattr("sys.argv", ["run_all.py"])

    def stopped(job, python, results):
        ran.append(job.name)
        if ran == ["first", "second"]:
            raise KeyboardInterrupt
        return True

    monkeypatch.setattr(run_all, "run", stopped)
    with pytest.raises(SystemExit, match="second: interrupted. The same command goes on there"):
        run_all.main()
    run_all.main()
    assert ran == ["first", "second", "second", "third"]
    assert "first            done" in capsys.readouterr().out


@pytest.mark.parametrize(("job", "given"), [("lqr", True), ("solver", False)])
def test_only_the_bounded_lqrs_are_told_where_hpipm_is(monkeypatch, tmp_path, job, given):
    ran = []
    jobs = tuple(each for each in run_all.JOBS if each.name == job)
    jobs = tuple(each._replace(reference=False) for each in jobs)
    for name, value in (("JOBS", jobs), ("KEPT", tmp_path)):
        monkeypatch.setattr(run_all, name, value)
    monkeypatch.setattr("sys.argv", ["run_all.py", "--hpipm", "/prefix", "--peers", sys.executable])
    monkeypatch.setattr(run_all, "run", lambda job, *rest: ran.append(job) or True)
    run_all.main()
    assert ("--hpipm" in ran[0].command) == given
    assert "--python" in ran[0].command


def test_the_load_is_counted_while_a_block_runs(monkeypatch):
    monkeypatch.setattr(load, "running", lambda: 3.0)
    monkeypatch.setattr(load, "EVERY_S", 0.01)
    with load.Load() as measured:
        pass
    assert measured.mean == 3.0


def test_packages_are_looked_for_with_the_interpreter_of_the_peers():
    assert run_all.absent(("json", "no_such_package"), sys.executable) == ("no_such_package",)


def test_the_process_that_looks_is_not_counted(monkeypatch):
    text = "8.2 7.9 7.1 3/812 4711"
    monkeypatch.setattr(load.Path, "read_text", lambda self: text)
    assert load.running() == 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "out"), [("profile_step", ["OUT"]), ("bench_throughput", ["--models", "unicycle"])]
)
def test_a_missing_cache_is_told_in_one_line(script, out, tmp_path):
    command = [sys.executable, str(ROOT / "benchmarks" / f"{script}.py"), str(tmp_path)]
    given = [str(tmp_path / each) if each == "OUT" else each for each in out]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run([*command, *given], capture_output=True, text=True, env=environment)
    assert done.returncode == 1
    [told] = done.stderr.strip().splitlines()
    assert told.startswith("`cache` must hold a finished conversion of 'thab_vru'")
