"""A single problem: solve and gradient, compiled one by one beside kernels on tensors, and the parts of the time.

python benchmarks/bench_single.py > benchmarks/results/single.md
python benchmarks/bench_single.py --kernels     # the kernels on tensors as well, which take minutes to compile
"""

import argparse
import os
import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))
from bench_solver_models import MODELS, problem  # noqa: E402

from diffstack_mmv.control import ILQR, Batched, DifferencedCurvature, ExactCurvature  # noqa: E402
from diffstack_mmv.control.native import solver as native  # noqa: E402
from diffstack_mmv.vehicles import load_vehicle  # noqa: E402

STEPS, RUNS = 30, 100


def spent(work):
    """Median processor time in ms."""
    times = []
    for _ in range(RUNS):
        start = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - start))
    return sorted(times)[len(times) // 2]


def measure(name, vehicle, one_by_one):
    """One row."""
    model = MODELS[name](load_vehicle(vehicle))
    cost, state = problem(model, 1, STEPS)
    curvature = ExactCurvature() if name == "kbm" else DifferencedCurvature()
    solver = ILQR(compile=True, tolerance=1e-4, curvature=curvature, one_by_one=one_by_one)
    guess = torch.zeros(1, STEPS, model.control_dim)

    def solve():
        return solver(Batched(model), cost, model.bounds, state, guess)

    inside, call = [], native.solved

    def timed(*arguments):
        start = time.process_time()
        result = call(*arguments)
        inside.append(1e3 * (time.process_time() - start))
        return result

    began = time.perf_counter(), os.times()
    solution = solve()
    first, after = time.perf_counter() - began[0], os.times()
    processor = sum(after[:4]) - sum(began[1][:4])
    native.solved = timed
    with torch.no_grad():
        alone = spent(solve)
    native.solved = call
    solve().states.square().sum().backward()
    both = spent(lambda: solve().states.square().sum().backward())
    kind = "library" if one_by_one else "kernels on tensors"
    library = f"{sorted(inside)[len(inside) // 2]:.2f}" if inside else "-"
    print(
        f"| {MODELS[name].__name__} {vehicle}, {kind} | {alone:.2f} | {library} | {both - alone:.2f} "
        f"| {(both - alone) / alone:.0%} | {int(solution.iterations)} | {first:.0f} | {processor:.0f} "
        f"| {os.getloadavg()[0]:.1f} |",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS))
    parser.add_argument("--vehicle", default="bicycle")
    parser.add_argument("--kernels", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"One problem, T = {STEPS}, float32, tolerance 1e-4, one thread; median processor time of {RUNS} solves. `in the "
        "library`: the part without the checks of the arguments and the search for the library. First call with an empty "
        "cache: seconds that passed, and seconds of the processor with those of the C++ compiler.\n"
    )
    print(
        "| model | solve, ms | in the library, ms | a gradient adds, ms | share of the solve | iterations "
        "| first call, s | processor, s | load of the machine |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name in arguments.models:
        measure(name, arguments.vehicle, 1)
        if arguments.kernels:
            measure(name, arguments.vehicle, 0)


if __name__ == "__main__":
    main()
