"""The same as bench_solver.py on problems that solvers without bounds can express, too.

    python benchmarks/bench_solver_free.py --python PATH   # peers from another environment

No bump and no box, and efforts weighed so that most solutions would stay inside the box on their
own: the cost is quadratic, the bicycle is not linear. Besides the times it measures the gradient of
every differentiable peer against the exact one. Writes solver_free.md to results/.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from bench_solver import (  # noqa: E402
    READING,
    arguments_of,
    collect,
    judge,
    surroundings,
    table,
    write,
)
from bench_solver_worker import EXACT  # noqa: E402

SOLVERS = (
    EXACT,
    "ours-compiled",
    "ours-eager",
    "mpc.pytorch",
    "pypose",
    "diffmpc",
    "trajax",
    "casadi-fatrop",
    "casadi-ipopt",
)
CLASSES = (
    "Fatrop and IPOPT are not asked for a gradient. pypose, diffmpc and mpc.pytorch differentiate without the curvature of the "
    "dynamics: that is their gradient error.",
    "pypose: the loop and the Jacobians of its MPC are of one problem; its LQR step is iterated here over the batch, with "
    "batched Jacobians, and without line search, which it has not.",
    "diffmpc: no line search, and conjugate gradients to 1e-6, which is the fastest of what was tried without loss of quality.",
)
SIZES = ("256:30", "64:30", "16:30", "64:10", "64:100", "1:30")


def judge_gradients(rows):
    """Give each row the median relative error of its gradients, over problems of the same optimum."""
    exact = {(row["batch"], row["steps"]): row for row in rows if row["solver"] == EXACT}
    for row in rows:
        measure = exact.get((row["batch"], row["steps"]))
        if "gradient" not in row or measure is None or row is measure:
            continue
        costs, right_costs = np.array(row["costs"]), np.array(measure["costs"])
        same = np.abs(costs - right_costs) <= 1e-4 * right_costs
        right = np.array(measure["gradient"])
        error = np.linalg.norm(np.array(row["gradient"]) - right, axis=1)
        if same.any():
            row["error"] = float(np.median((error / np.linalg.norm(right, axis=1))[same]))


def main():
    arguments = arguments_of(__doc__.splitlines()[0], SOLVERS, SIZES)
    rows, notes = collect(arguments, "free")
    judge_gradients(rows)
    judge(rows)
    shown = [row for row in rows if row["solver"] != EXACT]
    introduction = (
        "Kinematic bicycle to a goal, quadratic cost, no bounds, from zero controls, tolerance 1e-4, "
        f"{surroundings()}. Fatrop and IPOPT in float64, the others in float32. {READING} "
        "`backward`: gradient of the sum of all states and squared controls to the goal, ours to the "
        "wheelbase as well. `gradient error`: median relative error of it against this package's "
        "solver in float64 at a tolerance of 1e-16, over the problems that ended at the same cost. "
        f"Sizes in the order {', '.join(arguments.sizes)} (batch:T)."
    )
    columns = [
        ("gradient error", ".1e", "error"),
        ("first call s", ".1f", "first_s"),
        ("peak MiB", ".0f", "memory_mib"),
    ]
    write(
        arguments.results / "solver_free.md",
        table(shown, [*CLASSES, *notes], introduction, columns),
    )


if __name__ == "__main__":
    main()
