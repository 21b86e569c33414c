"""Memory that a backward pass needs after few and many iterations, implicit and unrolled.

python benchmarks/bench_solver_memory.py > benchmarks/results/solver_memory.md
"""

import multiprocessing
import resource
import sys
from dataclasses import replace
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))
from peers import driving, ours  # noqa: E402

from diffstack_mmv.control import ILQR, Bounds, Unrolled  # noqa: E402

BATCH, STEPS = 64, 100
RESIDENT = Path("/proc/self/statm")
MIB = 2**20


def resident_mib():
    """Memory of this process now."""
    return int(RESIDENT.read_text().split()[1]) * resource.getpagesize() / MIB


def measure(case):
    """Kept between forward and backward, and the peak above the start, in MiB."""
    unrolled, limit = case
    torch.set_num_threads(1)
    states, parameters = driving.instances(BATCH, STEPS)
    state, p = (torch.tensor(part, dtype=torch.float32) for part in (states, parameters))
    box = Bounds(torch.tensor(driving.LOWER), torch.tensor(driving.UPPER))
    wheelbase = torch.tensor(driving.WHEELBASE, requires_grad=True)
    solver = ILQR(max_iterations=limit, tolerance=1e-9)
    solve = replace(solver, gradient=Unrolled()) if unrolled else solver
    before = resident_mib()
    solution = solve(*ours.callables(p, wheelbase), box, state, torch.zeros(BATCH, STEPS, 2))
    kept = resident_mib() - before
    solution.controls.square().sum().backward()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before
    return int(solution.iterations.max()), kept, peak


def main():
    print(f"Batch {BATCH}, T = {STEPS}, float32, eager; every case in a process of its own.\n")
    print("| gradient | limit | iterations done | kept for the backward pass, MiB | peak, MiB |")
    print("|---|---|---|---|---|")
    context = multiprocessing.get_context("spawn")
    for unrolled in (False, True):
        for limit in (5, 50):
            with context.Pool(1) as pool:
                iterations, kept, peak = pool.map(measure, [(unrolled, limit)])[0]
            kind = "unrolled" if unrolled else "implicit"
            print(f"| {kind} | {limit} | {iterations} | {kept:.0f} | {peak:.0f} |", flush=True)


if __name__ == "__main__":
    main()
