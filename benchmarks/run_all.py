"""All benchmarks, one after the other: tells what they need and how long they take, resumes, marks what ran under load.

    python benchmarks/run_all.py                 # `make bench`: what is not done yet, in half an hour
    python benchmarks/run_all.py --size full     # `make bench SIZE=full`: all sizes and repetitions
    python benchmarks/run_all.py --dry-run       # tell, and stop
    python benchmarks/run_all.py --again lqr     # measure one again
    python benchmarks/run_all.py --fresh         # all again

The small size is a look at the same tables with fewer sizes and problems, in outputs/bench/small; the full one
writes benchmarks/results. What is done is kept in outputs/bench. A table is written when it is whole; the last line tells the load of the
machine meanwhile, and says so where other work has disturbed the times.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent))
from load import Load, remark  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
RESULTS, KEPT = ROOT / "benchmarks" / "results", ROOT / "outputs" / "bench"
REFERENCE = ROOT.parent / "shared" / "reference" / "mpc"
BUILT = ROOT / "outputs" / "peers" / "bin" / "python"  # by `make peers`
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class Job(NamedTuple):
    """One benchmark."""

    name: str
    minutes: float  # on an idle core
    command: tuple[str, ...]
    packages: tuple[str, ...] = ()  # without them it cannot run
    better_with: tuple[str, ...] = ()  # peers, skipped row by row
    writes: bool = False  # whether it writes its tables itself
    tells_where: bool = False  # whether it takes `--results`, the folder of its tables
    small: tuple[float, tuple[str, ...]] | None = None  # minutes, arguments besides; None: the same
    reference: bool = False  # whether it needs the reference solutions


BOXED = ("mpc", "casadi", "crocoddyl", "trajax")
FREE = ("mpc", "pypose", "diffmpc", "trajax", "casadi")
UNICYCLE = ("crocoddyl", "casadi", "trajax", "diffmpc")
FEW = ("--sizes", "64:30", "1:30", "--limit", "1", "--timeout", "300")
JOBS = (
    Job("dynamics", 3, ("-m", "pytest", "benchmarks/bench_dynamics.py", "--jaxtyping-packages=", "--benchmark-only",
                        "-m", "slow or not slow"), ("pytest_benchmark",), writes=True,
        small=(1, ("-k", "eager and bicycle or rollout"))),
    Job("solver", 25, ("benchmarks/bench_solver.py",), better_with=BOXED, writes=True,
        tells_where=True, small=(4, FEW)),
    Job("solver_free", 25, ("benchmarks/bench_solver_free.py",), better_with=FREE, writes=True,
        tells_where=True, small=(4, FEW)),
    Job("solver_unicycle", 8, ("benchmarks/bench_solver_unicycle.py",), better_with=UNICYCLE, writes=True,
        tells_where=True, small=(2, FEW)),
    Job("models", 4, ("benchmarks/bench_models.py",),
        small=(2, ("--batches", "1", "64", "--limit", "3"))),
    Job("solver_memory", 2, ("benchmarks/bench_solver_memory.py",)),
    Job("solver_profile", 3, ("benchmarks/bench_solver_profile.py",)),
    Job("library_profile", 1, ("benchmarks/bench_library_profile.py",)),
    Job("lqr", 25, ("benchmarks/bench_lqr.py", str(REFERENCE / "acados_lqr")),
        better_with=("crocoddyl", "casadi", "mpc", "osqp", "qpth", "cvxpygen", "cvxpylayers"), reference=True,
        small=(3, ("--sets", "test_umax1", "--limit", "1", "--timeout", "30"))),
    Job("startup", 7, ("benchmarks/bench_startup.py",), small=(3, ("--repetitions", "1"))),
    Job("constrained", 4, ("benchmarks/bench_constrained.py",), ("casadi",),
        small=(1, ("--count", "60"))),
    Job("gradients", 15, ("benchmarks/bench_solver_gradients.py",), reference=True,
        small=(2, ("--vehicles", "bicycle"))),
    Job("convergence", 10, ("benchmarks/bench_solver_convergence.py",), reference=True,
        small=(1, ("--count", "100"))),
)  # fmt: skip


def of_size(job, size):
    """A job with the arguments and the minutes of a size."""
    if size == "full" or job.small is None:
        return job
    minutes, more = job.small
    return job._replace(minutes=minutes, command=(*job.command, *more))


@cache
def absent(names, python):
    """Those of the packages of peers that an interpreter does not find."""
    look = "import sys; from importlib.util import find_spec; print(*[n for n in sys.argv[1:] if not find_spec(n)])"
    told = subprocess.run([python, "-c", look, *names], capture_output=True, text=True, check=True)
    return tuple(told.stdout.split())


def lacking(job):
    """What a job cannot run without and is not there."""
    missing = [name for name in job.packages if find_spec(name) is None]
    return [*missing, *([str(REFERENCE)] if job.reference and not REFERENCE.is_dir() else [])]


def plan(jobs, done, python=sys.executable):
    """Tell what will run, what it needs and how long it takes; the jobs that can run."""
    ready = []
    built = python != sys.executable
    print(f"Peers: {python}" if built else "Peers: no environment of their own, see `make peers`.")
    for job in jobs:
        if job.name in done:
            print(f"{job.name:16s} done {done[job.name]}")
        elif missing := lacking(job):
            print(f"{job.name:16s} skipped, not there: {', '.join(missing)}")
        else:
            without = absent(job.better_with, python)
            note = f"; rows named as absent: {', '.join(without)}" if without else ""
            print(f"{job.name:16s} about {job.minutes:g} min{note}")
            ready.append(job)
    total, load = sum(job.minutes for job in ready), os.getloadavg()[0]
    print(
        f"{len(ready)} to run, about {total:.0f} min of an idle core; load now {load:.1f}.",
        flush=True,
    )
    return ready


def folder_of(size):
    """Where the tables of a size go."""
    return RESULTS if size == "full" else KEPT / size


def run(job, python, results):
    """Run a job; whether it succeeded."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": path}
    output = None if job.writes else subprocess.PIPE
    command = [python, *job.command, *(["--results", str(results)] if job.tells_where else [])]
    with Load() as load:
        process = subprocess.run(
            command, cwd=ROOT, env=environment, stdout=output, text=True, check=False
        )
    if process.returncode == 0 and not job.writes:
        (results / f"{job.name}.md").write_text(process.stdout.rstrip() + "\n" + remark(load.mean))
    return process.returncode == 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dry-run", action="store_true")
    parser.add_argument("--fresh", action="store_true", help="forget what is done")
    parser.add_argument("--again", nargs="+", default=[], choices=[job.name for job in JOBS])
    parser.add_argument("--only", nargs="+", default=[], choices=[job.name for job in JOBS])
    parser.add_argument("--size", choices=("small", "full"), default="small")
    built = str(BUILT) if BUILT.exists() else sys.executable
    parser.add_argument("--peers", default=built, help="interpreter of the peers' environment")
    parser.add_argument("--hpipm", help="prefix where acados or hpipm and blasfeo are installed")
    arguments = parser.parse_args()
    known, results = KEPT / f"{arguments.size}.json", folder_of(arguments.size)
    done = json.loads(known.read_text()) if known.exists() and not arguments.fresh else {}
    done = {name: when for name, when in done.items() if name not in arguments.again}
    wanted = [job for job in JOBS if not arguments.only or job.name in arguments.only]
    chosen = [of_size(job, arguments.size) for job in wanted]
    ready = plan(chosen, done, arguments.peers)
    if arguments.dry_run:
        return
    failed = []
    results.mkdir(parents=True, exist_ok=True)
    KEPT.mkdir(parents=True, exist_ok=True)
    for job in ready:
        if job.better_with:
            job = job._replace(command=(*job.command, "--python", arguments.peers))
        if arguments.hpipm and job.name == "lqr":
            job = job._replace(command=(*job.command, "--hpipm", arguments.hpipm))
        began = time.monotonic()
        try:
            succeeded = run(job, sys.executable, results)
        except KeyboardInterrupt:
            raise SystemExit(f"{job.name}: interrupted. The same command goes on there.") from None
        if succeeded:
            done[job.name] = time.strftime("%Y-%m-%d %H:%M")
            known.write_text(json.dumps(done, indent=1))
            print(f"{job.name}: done in {(time.monotonic() - began) / 60:.1f} min", flush=True)
        else:
            failed.append(job.name)
            print(f"{job.name}: failed; the others go on", flush=True)
    if failed:
        raise SystemExit(f"Failed: {', '.join(failed)}. The same command tries them again.")


if __name__ == "__main__":
    main()
