"""Time, quality, gradient time and memory of trajectory optimisers on the same problems.

    python benchmarks/bench_solver.py run ours-compiled --out benchmarks/results/solver.jsonl
    python benchmarks/bench_solver.py table --out benchmarks/results/solver.jsonl

Peers are optional and run in an environment of their own: `mpc` (mpc.pytorch) and `casadi`. Times
are processor seconds of the process, the smallest of the repetitions, so that other work on the
machine disturbs them little.
"""

import argparse
import json
import platform
import resource
import sys
import time
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parent))
from peers import driving  # noqa: E402

SOLVERS = ("ours-compiled", "ours-eager", "mpc.pytorch", "ipopt")


def seconds(work, repetitions):
    """First call, then the smallest of the others, in processor seconds; and the last result."""
    times = []
    for _ in range(repetitions + 1):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return times[0], min(times[1:]) if repetitions else times[0], result


def measure_ours(states, parameters, steps, repetitions, compile):
    from peers import ours

    solve = ours.solver(states, parameters, steps, compile)
    with torch.no_grad():
        first, forward, solution = seconds(solve, repetitions)
    backward = []
    for _ in range(repetitions + 1):
        graph = solve()
        start = time.process_time()
        (graph.controls.square().sum() + graph.states.sum()).backward()
        backward.append(time.process_time() - start)
    converged = float(solution.converged.double().mean())
    return ours.controls_of(solution), dict(
        first_s=first,
        forward_s=forward,
        backward_s=min(backward),
        converged=converged,
        iterations=float(solution.iterations.double().mean()),
    )


def measure_peer(name, states, parameters, steps, repetitions):
    if name == "mpc.pytorch":
        from peers import mpc_pytorch

        first, forward, controls = seconds(
            lambda: mpc_pytorch.solve_all(states, parameters, steps), repetitions
        )
    else:
        from peers import ipopt

        nlp = ipopt.build(steps)
        first, forward, controls = seconds(
            lambda: ipopt.solve_all(nlp, states, parameters, steps), repetitions
        )
    return controls, dict(first_s=first, forward_s=forward)


def run(name, out, batches, horizons, repetitions):
    torch.set_num_threads(1)
    for steps in horizons:
        for batch in batches:
            states, parameters = driving.instances(batch, steps)
            if name.startswith("ours"):
                controls, row = measure_ours(
                    states, parameters, steps, repetitions, name.endswith("compiled")
                )
            else:
                controls, row = measure_peer(name, states, parameters, steps, repetitions)
            costs = driving.true_cost(states, parameters, controls)
            row |= dict(
                solver=name,
                batch=batch,
                steps=steps,
                ms_per_problem=1e3 * row["forward_s"] / batch,
                memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                costs=np.round(costs, 7).tolist(),
            )
            with out.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(name, batch, steps, round(row["ms_per_problem"], 4), "ms per problem", flush=True)


def table(out):
    """Markdown table and plot beside the raw rows; quality is against the best cost of any solver."""
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    rows = list({(r["solver"], r["batch"], r["steps"]): r for r in rows}.values())
    best = {}
    for row in rows:
        key = row["batch"], row["steps"]
        costs = np.array(row["costs"])
        best[key] = np.fmin(best.get(key, costs), costs)
    lines = [
        f"Kinematic bicycle around an obstacle, one thread, {platform.machine()}, torch "
        f"{torch.__version__}, float32 (IPOPT: float64). Processor time, smallest of the repetitions; "
        "start from zero controls; tolerance 1e-4. `best` is the share of problems within 1e-4 of the "
        "cheapest solution that any solver here found.",
        "",
        "| T | batch | solver | ms per problem | problems/s | backward / forward | best | converged "
        "| first call s | peak MiB |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda r: (r["steps"], r["batch"], r["ms_per_problem"])):
        costs, floor = np.array(row["costs"]), best[row["batch"], row["steps"]]
        share = np.mean(costs <= floor + 1e-4 * np.abs(floor))
        back = f"{row['backward_s'] / row['forward_s']:.2f}" if "backward_s" in row else "-"
        converged = f"{row['converged']:.3f}" if "converged" in row else "-"
        lines.append(
            f"| {row['steps']} | {row['batch']} | {row['solver']} | {row['ms_per_problem']:.3f} "
            f"| {1e3 / row['ms_per_problem']:.0f} | {back} | {share:.3f} | {converged} "
            f"| {row['first_s']:.1f} | {row['memory_mib']:.0f} |"
        )
    out.with_suffix(".md").write_text("\n".join(lines) + "\n")
    plot(rows, out.with_suffix(".png"))


def plot(rows, path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), constrained_layout=True)
    for name in SOLVERS:
        chosen = sorted(
            (r["batch"], r["ms_per_problem"])
            for r in rows
            if r["solver"] == name and r["steps"] == 30
        )
        if chosen:
            axes.loglog(*zip(*chosen, strict=True), marker="o", label=name)
    axes.set(
        xlabel="batch", ylabel="processor time per problem, ms", title="Kinematic bicycle, T = 30"
    )
    axes.legend()
    figure.savefig(path, dpi=150)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("run", "table"))
    parser.add_argument("solver", nargs="?", choices=SOLVERS)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/solver.jsonl"))
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 16, 64, 256])
    parser.add_argument("--horizons", type=int, nargs="+", default=[30])
    parser.add_argument("--repetitions", type=int, default=5)
    arguments = parser.parse_args()
    if arguments.action == "table":
        table(arguments.out)
    else:
        run(
            arguments.solver,
            arguments.out,
            arguments.batches,
            arguments.horizons,
            arguments.repetitions,
        )


if __name__ == "__main__":
    main()
