"""The same as bench_solver.py on the unicycle that crocoddyl brings in C++, with and without bounds.

    python benchmarks/bench_solver_unicycle.py --python PATH   # peers from another environment

Every peer that can express it is there; ours and the others have the formulas of crocoddyl's ActionModelUnicycle.
Writes solver_unicycle.md to results/.
"""

import sys
from pathlib import Path

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

SOLVERS = ("ours-compiled", "crocoddyl", "casadi-fatrop", "casadi-ipopt", "trajax", "diffmpc")
SIZES = ("256:30", "64:30", "16:30", "1:30")
CLASSES = {
    "unicycle": (
        "With bounds of both controls",
        "What each solves: ours, crocoddyl (BoxFDDP), fatrop and IPOPT the box as it is; trajax a quadratic penalty in its "
        "place. diffmpc knows no bounds.",
    ),
    "unicycle-free": (
        "Without bounds",
        "crocoddyl by FDDP. Gradients are not compared here: see solver_free.md.",
    ),
}


def main():
    arguments = arguments_of(__doc__.splitlines()[0], SOLVERS, SIZES)
    lines = [
        f"Unicycle that returns to the origin, from zero controls, {surroundings()}. Ours, trajax and diffmpc in "
        f"float32, the others in float64; tolerance 1e-4. {READING} Sizes in the order {', '.join(arguments.sizes)} (batch:T). crocoddyl has the "
        "model, its derivatives and the solver in C++ (ActionModelUnicycle), on one thread; it stops where the squares of its slopes sum up to 1e-4.",
    ]
    chosen, kept = arguments.solvers, arguments.rows
    for problem, (title, note) in CLASSES.items():
        bounded = problem == "unicycle"
        arguments.rows = kept and kept.with_stem(f"{kept.stem}-{problem}")
        arguments.solvers = [
            f"{name}-penalty" if bounded and name == "trajax" else name
            for name in chosen
            if not (bounded and name == "diffmpc")
        ]
        rows, notes = collect(arguments, problem)
        judge(rows)
        columns = [("first call s", ".1f", "first_s"), ("peak MiB", ".0f", "memory_mib")]
        lines += ["", *table(rows, [note, *notes], f"{title}:", columns)]
    write(arguments.results / "solver_unicycle.md", lines)


if __name__ == "__main__":
    main()
