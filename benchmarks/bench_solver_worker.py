"""Times one optimiser on all sizes, in a process of its own; started by bench_solver.py, _free.py and _unicycle.py."""

import argparse
import importlib
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from peers.problems import PROBLEMS  # noqa: E402

MODULES = {
    "mpc.pytorch": "mpc_pytorch",
    "casadi-ipopt": "ipopt",
    "casadi-fatrop": "fatrop",
    "crocoddyl": "crocoddyl_unicycle",
    "crocoddyl-python-model": "crocoddyl_box",
    "trajax-penalty": "trajax_penalty",
    "trajax": "trajax_penalty",
    "pypose": "pypose_lqr",
    "diffmpc": "diffmpc_sqp",
}
EXACT = "ours-exact"
"""This package's solver in float64 to the last digit: its gradient is the measure of the others."""
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


def measure_ours(name, states, parameters, steps, limit_s, problem):
    """Forward and backward of this package's solver."""
    import torch
    from peers import in_torch, ours

    torch.set_num_threads(1)
    exact = dict(dtype=torch.float64) if name == EXACT else {}
    leaves = ours.leaves_of(parameters, **exact, problem=problem)
    tolerance = 1e-16 if exact else 1e-4
    solve = ours.solver(states, leaves, steps, name == "ours-compiled", problem, tolerance)
    with torch.no_grad():
        first, forward, solution = fastest(solve, limit_s)
    graphs = [solve() for _ in range(4)]

    def backward():
        graph = graphs.pop()
        return torch.autograd.grad(in_torch.loss(graph.states, graph.controls), leaves)[0]

    _, back, gradient = fastest(backward, limit_s, 3)
    converged = float(solution.converged.double().mean())
    row = dict(first_s=first, forward_s=forward, backward_s=back, converged=converged)
    return ours.controls_of(solution), row | dict(gradient=gradient[:, : problem.states].tolist())


def measure_peer(name, states, parameters, steps, limit_s, problem):
    """Forward of a peer, and backward where problem and peer allow it."""
    peer = importlib.import_module("peers." + MODULES[name])
    solve = peer.prepare(states, parameters, steps, problem)
    first, forward, controls = fastest(solve, limit_s)
    row = dict(first_s=first, forward_s=forward)
    if problem.differentiated and hasattr(peer, "prepare_gradient"):
        record = peer.prepare_gradient(states, parameters, steps, problem)
        graphs = [record() for _ in range(4)]
        _, back, gradient = fastest(lambda: graphs.pop()(), limit_s, 3)
        row |= dict(backward_s=back, gradient=gradient.tolist())
    return controls, row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("solver")
    parser.add_argument("--problem", choices=PROBLEMS, default="obstacle")
    parser.add_argument("--sizes", nargs="+", required=True, help="batch:steps")
    parser.add_argument("--limit", type=float, default=20.0, help="seconds of repetitions per size")
    arguments = parser.parse_args()
    problem = PROBLEMS[arguments.problem]
    measure = measure_ours if arguments.solver.startswith("ours") else measure_peer
    for size in arguments.sizes:
        batch, steps = map(int, size.split(":"))
        given = problem.instances(batch, steps)
        try:
            controls, row = measure(arguments.solver, *given, steps, arguments.limit, problem)
        except ModuleNotFoundError as missing:
            print(missing, file=sys.stderr)
            raise SystemExit(MISSING) from missing
        row |= dict(
            solver=arguments.solver,
            batch=batch,
            steps=steps,
            memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            costs=np.round(problem.true_cost(*given, controls), 7).tolist(),
        )
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
