"""Where the time of a compiled solve goes, with the work that has to be done beside it.

    python benchmarks/bench_solver_profile.py > benchmarks/results/solver_profile.md

Floor: multiplications and additions of the small matrices (counted by hand), at the rate that a long fused
multiply-add loop reaches in this process, and bytes of the arrays each part reads and writes, at the rate of a copy.
"""

import collections
import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))
from peers import driving, ours  # noqa: E402

from diffstack_mmv.control import compilation  # noqa: E402

BATCH, STEPS, N, M, SIZES = 256, 30, 4, 2, 8
STAGE = N * N + N * M + N + M + N * N + M * N + M * M + M  # numbers per time in the local model


def rates():
    """Operations per second of fused multiply-adds on a small array, bytes per second of a copy."""
    small, large = torch.randn(4096), torch.randn(1 << 24)
    compute = smallest(lambda: [torch.addcmul(small, small, small) for _ in range(1000)])
    copy = smallest(large.clone)
    return 2 * 4096 * 1000 / compute, 8 * large.numel() / copy


def smallest(work):
    """Least processor time of five runs."""
    times = []
    for _ in range(5):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def floors():
    """Operations and bytes per call of each kernel at full batch."""
    pairs = BATCH * STEPS
    riccati = 2 * (2 * N**3 + 3 * N * N * M + 3 * N * M * M) + 200
    step, cost = 60, 60
    model = 3 * (N + M) * (step + cost) + 2 * N * step
    return {
        "expand": (pairs * model, 4 * pairs * (STAGE + 2 * N + 2 * M)),
        "box_policy": (pairs * riccati, 4 * pairs * (STAGE + M + M * N + 3)),
        "attempt": (
            pairs * SIZES * (step + cost + 2 * M * N),
            4 * pairs * (SIZES * (N + M) + M + M * N + 2 * (N + M)),
        ),
    }


def main():
    """Time every kernel inside of real solves."""
    torch.set_num_threads(1)
    spent, calls, plain = collections.Counter(), collections.Counter(), compilation.Kernel.__call__

    def timed(kernel, *arguments):
        start = time.process_time()
        result = plain(kernel, *arguments)
        spent[kernel.function.__name__] += time.process_time() - start
        calls[kernel.function.__name__] += 1
        return result

    solve = ours.solver(*driving.instances(BATCH, STEPS), STEPS, True)
    with torch.no_grad():
        solve()
        compilation.Kernel.__call__ = timed
        total = 5 * smallest(solve)
    compute, copy = rates()
    floor = floors()
    print(
        f"Batch {BATCH}, T = {STEPS}, float32, one thread; milliseconds of one solve, mean of five.\n"
    )
    print(f"Measured rates: {compute / 1e9:.1f} Gflop/s, {copy / 1e9:.1f} GB/s.\n")
    print(
        "| part | calls | ms | ms per call | floor: arithmetic ms per full call | floor: bytes ms per full call |"
    )
    print("|---|---|---|---|---|---|")
    for name in spent:
        operations, moved = floor.get(name, (0, 0))
        print(
            f"| {name} | {calls[name] / 5:.0f} | {1e3 * spent[name] / 5:.1f} "
            f"| {1e3 * spent[name] / calls[name]:.2f} | {1e3 * operations / compute:.3f} | {1e3 * moved / copy:.3f} |"
        )
    rest = 1e3 * (total - sum(spent.values())) / 5
    print(f"| rest: loop, second pass selection, narrowing | | {max(rest, 0):.1f} | | | |")


if __name__ == "__main__":
    main()
