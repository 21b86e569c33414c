"""Where the time of a solve in kernels on tensors goes, with the work that has to be done beside it.

    python benchmarks/bench_solver_profile.py > benchmarks/results/solver_profile.md

Floor: multiplications and additions (counted by hand), at the rate of a matrix product in this process, and bytes of
the arrays that each part has to read and write, at the rate of a copy.
"""

import collections
import os
import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))
from peers import driving, ours  # noqa: E402

from diffstack_mmv.control import compilation  # noqa: E402

BATCH, STEPS, N, M, SIZES, RUNS = 256, 30, 4, 2, 8, 5
STAGE = N * N + N * M + N + M + N * N + M * N + M * M + M  # numbers per time in the local model


def rates():
    """Operations per second of a matrix product in cache, bytes per second of a large copy."""
    square, large = torch.randn(384, 384), torch.randn(1 << 23)
    compute = smallest(lambda: [square @ square for _ in range(20)])
    copy = smallest(large.clone)
    return 20 * 2 * 384**3 / compute, 8 * large.numel() / copy


def smallest(work):
    """Least processor time of five runs."""
    times = []
    for _ in range(5):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def floors():
    """Operations and bytes that each kernel needs per problem."""
    riccati = 2 * (2 * N**3 + 3 * N * N * M + 3 * N * M * M) + 200
    step, cost = 60, 60
    model = 3 * (N + M) * (step + cost) + 2 * N * step
    rolled = SIZES * (N + M) + M + M * N + 2 * (N + M)
    return {
        "expand": (STEPS * model, 4 * STEPS * (STAGE + 2 * N + 2 * M)),
        "box_policy": (STEPS * riccati, 4 * STEPS * (STAGE + M + M * N + 3)),
        "attempt": (STEPS * SIZES * (step + cost + 2 * M * N), 4 * STEPS * rolled),
    }


def problems_of(arguments):
    """Number of problems in a call: every kernel is given a vector or record of the batch."""
    return max(
        tensor.shape[-1]
        for argument in arguments
        for tensor in compilation.hidden_tensors(argument if not callable(argument) else ())
        if tensor.dim() == 3
    )


def main():
    """Time every kernel inside of real solves."""
    torch.set_num_threads(1)
    spent, calls, problems = (collections.Counter() for _ in range(3))
    plain = compilation.Kernel.__call__

    def timed(kernel, *arguments):
        start = time.process_time()
        result = plain(kernel, *arguments)
        name = kernel.function.__name__
        spent[name] += time.process_time() - start
        calls[name] += 1
        problems[name] += problems_of(arguments)
        return result

    states, parameters = driving.instances(BATCH, STEPS)
    solve = ours.solver(states, ours.leaves_of(parameters), STEPS, True, one_by_one=0)
    with torch.no_grad():
        solve()
        whole = smallest(solve)
        compilation.Kernel.__call__ = timed
        for _ in range(RUNS):
            solve()
    compute, copy = rates()
    floor = floors()
    print(
        f"Batch {BATCH}, T = {STEPS}, float32, one thread; processor time of one solve, mean of {RUNS}; load of the machine {os.getloadavg()[0]:.1f}."
    )
    print(
        f"The fastest solve took {1e3 * whole:.1f} ms. The batch is halved as problems finish: `problems` counts all that were handed over."
    )
    print(
        f"Floor: {compute / 1e9:.0f} Gflop/s in a matrix product and {copy / 1e9:.1f} GB/s in a copy, measured in this process.\n"
    )
    print(
        "| part | calls | problems | ms | share | floor: operations, ms | floor: bytes, ms | ms / larger floor |"
    )
    print("|---|---|---|---|---|---|---|---|")
    total = sum(spent.values())
    for name, seconds in spent.most_common():
        operations, moved = (problems[name] / RUNS * each for each in floor[name])
        bounds = 1e3 * operations / compute, 1e3 * moved / copy
        mean = 1e3 * seconds / RUNS
        print(
            f"| {name} | {calls[name] / RUNS:.0f} | {problems[name] / RUNS:.0f} | {mean:.1f} | {seconds / total:.0%} "
            f"| {bounds[0]:.2f} | {bounds[1]:.2f} | {mean / max(bounds):.1f} |"
        )


if __name__ == "__main__":
    main()
