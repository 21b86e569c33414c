"""Processor time until a command answers: help, its configuration, and every kind of mistake in it.

    python benchmarks/bench_startup.py [--scripts train evaluate ...] [--repetitions 3]

Every answer is a process of its own on one thread; seconds of the processor, user and system, the
least of all repetitions, since other work only adds to it. Prints Markdown: a row per script, and
what `import torch` takes beside it, which a value that a part judges cannot do without.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from dmmv_conventions.cache import FORMAT_VERSION, STATE_FILE  # noqa: E402

FROM_CACHE = "data.cache={cache}"
RECORDED = [FROM_CACHE, "data.root={run}"]
CHECKED = [FROM_CACHE, "checkpoint=pretrained", "split=train"]
KINDS = ("unknown key", "unknown choice", "wrong type", "missing file", "value judged by a part")
# script -> arguments of each kind of mistake; None where a script can make no such mistake
MISTAKES = {
    "closed_loop_table": (["rws=[]"], ["table=none"], ["dry_run=maybe"], None, ["launcher.processes=0"]),
    "compare": (["rns=[]"], ["wandb=some"], ["runs=1"], ["runs=[nowhere]"], ["runs=[{run}]", "score=none"]),
    "convert": (["dt=1"], ["data=none"], [*RECORDED, "workers=many"], [FROM_CACHE, "data.root=nowhere"], [*RECORDED, "dt_s=-1"]),
    "dashboard": (["entities=a"], None, ["modes=1"], None, ["entity=a", "modes=[flying]"]),
    "download_imptc": (["part=a"], None, None, None, ["parts=none"]),
    "evaluate": (["check_point=a"], ["goal=none"], ["batch_size=many", FROM_CACHE], ["checkpoint=nowhere.ckpt", FROM_CACHE],
                 [*CHECKED, "baselines.simple.ctra.predictor.dt_s=-1"]),
    "export_planner": (["agnts=1"], ["solver=none"], ["agents=many"], ["checkpoint=nowhere.ckpt"],
                       ["solver.max_iterations=-1"]),
    "generate_sample": (["sed=1"], None, ["duration_s=long"], None, ["sequences=[a]"]),
    "identify": (["track=1"], ["vehicle=none"], [FROM_CACHE, "tracks=many"], ["data.cache=nowhere"], [FROM_CACHE, "foresee_s=-1"]),
    "navigate": (["case=1"], ["controller=none"], ["cases=many"], ["people=predictor", "people_checkpoint=nowhere.ckpt"],
                 ["search.samples=0"]),
    "report": (["run=[]"], None, ["runs=1"], ["runs=[nowhere]"], ["runs=[{run}]", "episodes=-1"]),
    "results": (["size.seds=[]"], ["size=none"], ["resamples=many"], None, ["launcher.processes=0"]),
    "side_by_side": (["run=[]"], None, ["runs=1"], ["runs=[nowhere,nowhere]", "cases=[1]"],
                     ["runs=[a,b]", "cases=[1]", "movie=none"]),
    "simulate": (["speed=1"], ["dynamics=none"], ["speed_mps=fast"], ["controls=nowhere.csv"], ["others.kbm.dt_s=-1"]),
    "train": (["epoch=1"], ["dynamics=none"], [FROM_CACHE, "epochs=many"], ["data.cache=nowhere"],
              [FROM_CACHE, "cost.weights.final_goal=-1"]),
    "train_policy": (["env=1"], ["scenario=none"], ["envs=many"], None, ["view.nearest=0"]),
    "tune": (["case=1"], ["tuner=none"], ["cases=many"], None, ["tuner.rounds=0"]),
}  # fmt: skip


def prepared(folder):
    """As much of a conversion and of a run as is read before the work begins; what names stand for."""
    cache, run = folder / "cache", folder / "run"
    (cache / "thab_vru").mkdir(parents=True)
    run.mkdir()
    (run / "metrics.json").write_text("{}")
    scenes = [{"name": "one", "split": "train", "agents": {"bicycle": 1}}]
    state = {"format_version": FORMAT_VERSION, "complete": True, "scenes": scenes}
    (cache / "thab_vru" / STATE_FILE).write_text(json.dumps(state))
    return {"cache": cache, "run": run}


def spent_s(command, succeeds, aloud):
    """Processor seconds of a process, which has to succeed or to fail with one line."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment
    )
    told = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    lines = told.strip().splitlines()
    if (process.returncode == 0) != succeeds or (not succeeds and len(lines) != 1):
        raise SystemExit(f"{' '.join(command)}: exit status {process.returncode}, told: {told}")
    if aloud and not succeeds:
        sys.stderr.write(f"{Path(command[1]).stem}: {lines[0]}\n")
    return used.ru_utime + used.ru_stime


def answers(script, names, out):
    """Command line of each answer of a script, and whether it succeeds."""
    file = str(ROOT / "scripts" / f"{script}.py")
    yield [file, "--help"], True
    yield [file, "--cfg", "job", f"out={out}"], True
    for given in MISTAKES[script]:
        told = given and [file, *(each.format(**names) for each in given), f"out={out}"]
        yield told, False


def least_s(command, succeeds, repetitions, aloud=False):
    """The least of some measurements of one answer; a dash where there is none."""
    if command is None:
        return "-"
    whole = [sys.executable, *command]
    times = [
        spent_s(whole, succeeds, aloud and first) for first in [True] + (repetitions - 1) * [False]
    ]
    return f"{min(times):.1f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scripts", nargs="+", default=list(MISTAKES), choices=list(MISTAKES))
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument(
        "--aloud", action="store_true", help="what was told of each mistake, to stderr"
    )
    given = parser.parse_args()
    print("# Start-up\n")
    print("Processor seconds until a command answers, one thread.\n")
    print(f"| script | --help | --cfg job | {' | '.join(KINDS)} |")
    print("|---|" + (2 + len(KINDS)) * "---|")
    with tempfile.TemporaryDirectory() as folder:
        names = prepared(Path(folder))
        for script in given.scripts:
            rows = answers(script, names, Path(folder) / "out")
            cells = [least_s(*row, given.repetitions, given.aloud) for row in rows]
            print(f"| {script} | {' | '.join(cells)} |", flush=True)
    torch = least_s(["-c", "import torch"], True, given.repetitions)
    print(f"\n`import torch` alone takes {torch} s.")


if __name__ == "__main__":
    main()
