"""Times one optimiser on all sizes, in a process of its own; started by bench_solver.py."""

import argparse
import importlib
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from peers import driving  # noqa: E402

MODULES = {
    "mpc.pytorch": "mpc_pytorch",
    "casadi-ipopt": "ipopt",
    "crocoddyl-python-model": "crocoddyl_box",
    "trajax-penalty": "trajax_penalty",
}
MISSING = 3
"""Exit status where the package of a peer is not installed."""


def fastest(work, limit_s, repetitions=7):
    """First call, the smallest of the others in processor seconds, the last result.

    Repeats at least once, then until the time limit is spent.
    """
    times, began = [], time.monotonic()
    while len(times) < 2 or (len(times) <= repetitions and time.monotonic() - began < limit_s):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return times[0], min(times[1:]), result


def measure_ours(states, parameters, steps, limit_s, compiled):
    """Forward and backward of this package's solver."""
    import torch
    from peers import ours

    torch.set_num_threads(1)
    solve = ours.solver(states, parameters, steps, compiled)
    with torch.no_grad():
        first, forward, solution = fastest(solve, limit_s)
    graphs = [solve() for _ in range(4)]

    def backward():
        graph = graphs.pop()
        (graph.controls.square().sum() + graph.states.sum()).backward()

    _, back, _ = fastest(backward, limit_s, 3)
    converged = float(solution.converged.double().mean())
    row = dict(first_s=first, forward_s=forward, backward_s=back, converged=converged)
    return ours.controls_of(solution), row


def measure_peer(name, states, parameters, steps, limit_s):
    """Forward of a peer."""
    solve = importlib.import_module("peers." + MODULES[name]).prepare(states, parameters, steps)
    first, forward, controls = fastest(solve, limit_s)
    return controls, dict(first_s=first, forward_s=forward)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("solver")
    parser.add_argument("--sizes", nargs="+", required=True, help="batch:steps")
    parser.add_argument("--limit", type=float, default=20.0, help="seconds of repetitions per size")
    arguments = parser.parse_args()
    for size in arguments.sizes:
        batch, steps = map(int, size.split(":"))
        problem = driving.instances(batch, steps)
        if arguments.solver.startswith("ours"):
            compiled = arguments.solver == "ours-compiled"
            controls, row = measure_ours(*problem, steps, arguments.limit, compiled)
        else:
            try:
                controls, row = measure_peer(arguments.solver, *problem, steps, arguments.limit)
            except ModuleNotFoundError as missing:
                print(missing, file=sys.stderr)
                raise SystemExit(MISSING) from missing
        row |= dict(
            solver=arguments.solver,
            batch=batch,
            steps=steps,
            memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            costs=np.round(driving.true_cost(*problem, controls), 7).tolist(),
        )
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
