"""Time, quality, gradient time and memory of trajectory optimisers on the same problems.

    python benchmarks/bench_solver.py                      # all, with this interpreter
    python benchmarks/bench_solver.py --python PATH        # peers from another environment
    python benchmarks/bench_solver.py --rows FILE --solvers ours-eager    # again, the others from FILE

Each optimiser runs in a process of its own, on one thread; one that is not installed is skipped and
said to be. Times are processor seconds, the smallest of the repetitions, so that other work on the
machine disturbs them little; a row that was measured beside other work bears a star. Writes solver.md and
solver.png to results/.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from bench_solver_worker import MISSING  # noqa: E402
from load import BUSY, Load  # noqa: E402

RESULTS = Path(__file__).parent / "results"
SOLVERS = (
    "ours-compiled",
    "ours-eager",
    "mpc.pytorch",
    "casadi-fatrop",
    "casadi-ipopt",
    "crocoddyl-python-model",
    "trajax-penalty",
)
SIZES = ("256:30", "64:30", "16:30", "64:10", "64:100", "1:30")
READING = (
    "`times ours`: time per problem by that of ours compiled, of the same run. `best`: share of problems within 1e-4 "
    "relative cost of the cheapest solution that any of these found. `first call`: with tracing and generating code, "
    "without the C++ compiler's own time. `peak`: of the process up to that size."
)
CLASSES = (
    "What each solves: ours, crocoddyl (BoxFDDP), fatrop, IPOPT and mpc.pytorch the box as it is; trajax a quadratic penalty in its place.",
    "Fatrop and IPOPT evaluate the problem in CasADi's virtual machine, crocoddyl in a model in Python, which dominates its time: "
    "with a model of its own in C++ it is in solver_unicycle.md.",
    "PyPose and Toyota's diffmpc know no bounds: they are in solver_free.md.",
)
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


def rows_of(name, arguments, problem):
    """Rows of one optimiser, and a note if there is something to tell."""
    worker = str(Path(__file__).with_name("bench_solver_worker.py"))
    python = sys.executable if name.startswith("ours") else arguments.python
    command = [python, worker, name, "--problem", problem, "--limit", str(arguments.limit)]
    command += ["--sizes", *arguments.sizes]
    with tempfile.TemporaryDirectory() as cache, Load() as load:
        cold = {"TORCHINDUCTOR_CACHE_DIR": cache} if arguments.cold else {}
        environment = os.environ | ONE_THREAD | cold
        process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True)
        try:
            output, note = process.communicate(timeout=arguments.timeout)[0], None
        except subprocess.TimeoutExpired:
            process.kill()
            output = process.communicate()[0]
            note = f"{name}: stopped after {arguments.timeout} s"
    if process.returncode == MISSING:
        note = f"{name}: no rows, not installed"
    elif process.returncode > 0:
        note = f"{name}: failed with status {process.returncode}"
    rows = [json.loads(line) for line in output.splitlines() if line.startswith("{")]
    for row in rows:
        row["load"] = load.mean
    print(note or f"{name}: {len(rows)} sizes", flush=True)
    return rows, note


def judge(rows):
    """Replace the costs of each row by the share within 1e-4 of the cheapest of any optimiser."""
    best = {}
    for row in rows:
        key = row["batch"], row["steps"]
        best[key] = np.fmin(best.get(key, np.inf), np.array(row["costs"]))
    for row in rows:
        floor = best[row["batch"], row["steps"]]
        row["best"] = float(np.mean(np.array(row.pop("costs")) <= floor + 1e-4 * np.abs(floor)))
        row["ms_per_problem"] = 1e3 * row["forward_s"] / row["batch"]
    ours = {
        (row["batch"], row["steps"]): row["ms_per_problem"]
        for row in rows
        if row["solver"] == "ours-compiled"
    }
    for row in rows:
        if (row["batch"], row["steps"]) in ours:
            row["ratio"] = row["ms_per_problem"] / ours[row["batch"], row["steps"]]


def surroundings():
    """What the times depend on besides the solvers."""
    return f"one thread, {platform.machine()}; processor time, smallest of the repetitions"


def table(rows, notes, introduction, last_columns):
    """Markdown lines; the last columns are (heading, format, key), a dash where a row lacks them."""
    headings = ["T", "batch", "solver", "ms per problem", "times ours", "backward ms"]
    headings += ["backward / forward", "best", *(heading for heading, _, _ in last_columns)]
    lines = [introduction, "", f"| {' | '.join(headings)} |", "|---" * len(headings) + "|"]
    for row in sorted(rows, key=lambda r: (r["steps"], r["batch"], r["ms_per_problem"])):
        back = row.get("backward_s")
        star = " *" if row.get("load", 0.0) > BUSY else ""
        cells = [str(row["steps"]), str(row["batch"]), row["solver"] + star]
        cells += [f"{row['ms_per_problem']:.3f}", f"{row['ratio']:.1f}" if "ratio" in row else "-"]
        cells += [f"{1e3 * back:.2f}", f"{back / row['forward_s']:.2f}"] if back else ["-", "-"]
        cells += [f"{row['best']:.3f}"]
        cells += [format(row[key], form) if key in row else "-" for _, form, key in last_columns]
        lines.append(f"| {' | '.join(cells)} |")
    if any(row.get("load", 0.0) > BUSY for row in rows):
        notes = [*notes, "\\* **measured under load**: more than one process ran beside it."]
    return [*lines, "", *(f"- {note}" for note in notes)]


def write(path, lines):
    """A Markdown file, its folder as well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines).rstrip() + "\n")


def plot(rows, path):
    """Time per problem over the batch."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8.5, 4), constrained_layout=True)
    for name in SOLVERS:
        chosen = sorted(
            (r["batch"], r["ms_per_problem"])
            for r in rows
            if r["solver"] == name and r["steps"] == 30
        )
        if chosen:
            axes.loglog(*zip(*chosen, strict=True), marker="o", label=name)
    axes.set_xticks([1, 16, 64, 256], ["1", "16", "64", "256"])
    axes.minorticks_off()
    axes.set(
        xlabel="batch", ylabel="processor time per problem in ms", title="Kinematic bicycle, T = 30"
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1, 1))
    figure.savefig(path, dpi=120)


def arguments_of(description, solvers, sizes):
    """The command line."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--solvers", nargs="+", choices=solvers, default=solvers)
    parser.add_argument("--sizes", nargs="+", default=sizes, help="batch:steps")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the peers")
    parser.add_argument("--limit", type=float, default=20.0, help="seconds of repetitions per size")
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds per optimiser")
    parser.add_argument("--cold", action="store_true", help="compile with an empty cache")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the tables")
    parser.add_argument("--rows", type=Path, help="rows with all costs, read and written")
    return parser.parse_args()


def collect(arguments, problem):
    """Rows of all optimisers, with their costs, and notes."""
    kept = (
        json.loads(arguments.rows.read_text()) if arguments.rows and arguments.rows.exists() else []
    )
    rows, notes = [row for row in kept if row["solver"] not in arguments.solvers], []
    for name in arguments.solvers:
        found, note = rows_of(name, arguments, problem)
        rows += found
        notes += [note] if note else []
    if arguments.rows:
        arguments.rows.write_text(json.dumps(rows))
    return rows, notes


def main():
    arguments = arguments_of(__doc__.splitlines()[0], SOLVERS, SIZES)
    rows, notes = collect(arguments, "obstacle")
    judge(rows)
    introduction = (
        f"Kinematic bicycle around an obstacle, from zero controls, tolerance 1e-4, {surroundings()}. "
        f"Ours, mpc.pytorch and trajax in float32, the others in float64. {READING} Sizes in the order "
        f"{', '.join(arguments.sizes)} (batch:T)."
    )
    notes = [*CLASSES, *notes]
    columns = [
        ("converged", ".3f", "converged"),
        ("first call s", ".1f", "first_s"),
        ("peak MiB", ".0f", "memory_mib"),
    ]
    write(arguments.results / "solver.md", table(rows, notes, introduction, columns))
    plot(rows, arguments.results / "solver.png")


if __name__ == "__main__":
    main()
