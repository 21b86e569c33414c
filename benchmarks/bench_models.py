"""Solve and gradient of the package's own dynamics models: a single problem and batches, one by one in a library.

python benchmarks/bench_models.py > benchmarks/results/models.md
python benchmarks/bench_models.py --kernels     # kernels on tensors as well, which take minutes to compile

The problems of bench_solver.py with the dynamics replaced: the cost sees the model's motion.
"""

import argparse
import os
import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))
from peers import driving, ours  # noqa: E402

from diffstack_mmv.control import ILQR, Batched, CurvatureBySize  # noqa: E402
from diffstack_mmv.control.native import solver as native  # noqa: E402
from diffstack_mmv.dynamics import DiffGM3, DiffKBM  # noqa: E402
from diffstack_mmv.types import Motion  # noqa: E402
from diffstack_mmv.vehicles import load_vehicle  # noqa: E402

MODELS = {"kbm": DiffKBM, "gm3": DiffGM3}
STEPS = 30
COLUMNS = (
    *("model", "batch", "ms per problem", "in the library", "a gradient adds"),
    *("share of the solve", "converged", "iterations", "first call, s", "processor, s"),
)


def problem(model, batch):
    """Cost and initial state of `batch` problems."""
    states, parameters = (
        torch.tensor(part, dtype=torch.float32) for part in driving.instances(batch, STEPS)
    )
    x, y, heading, speed = states.unbind(-1)
    zero = torch.zeros_like(x)
    start = Motion(torch.stack([x, y], -1), heading, torch.stack([speed, zero], -1), zero)

    def cost(states, controls, parameters):
        motion = model.motion(states, controls)
        seen = (*motion.position.unbind(-1), motion.heading, motion.velocity[..., 0])
        p = parameters.unsqueeze(-2).unbind(-1)
        running = driving.stage_cost(ours.Space, seen, controls.unbind(-1), p)
        final = driving.final_cost(seen, p)
        return torch.cat([running[..., :-1], final[..., -1:]], -1)

    return Batched(cost, parameters), model.initial_state(start).detach()


class Clocked:
    """Median processor times in ms of all calls of some work, and of the library inside of them."""

    def __init__(self, limit_s, most=100):
        self.limit_s, self.most = limit_s, most

    def __call__(self, work):
        """Both medians."""
        whole, inside, call = [], [], native.solved

        def timed(*arguments):
            start = time.process_time()
            result = call(*arguments)
            inside.append(1e3 * (time.process_time() - start))
            return result

        native.solved = timed
        began = time.monotonic()
        while not whole or (len(whole) < self.most and time.monotonic() - began < self.limit_s):
            start = time.process_time()
            work()
            whole.append(1e3 * (time.process_time() - start))
        native.solved = call
        return middle(whole), middle(inside) if inside else float("nan")


def middle(values):
    return sorted(values)[len(values) // 2]


def measure(name, vehicle, batch, one_by_one, limit_s):
    """One row."""
    model = MODELS[name](load_vehicle(vehicle))
    cost, state = problem(model, batch)
    solver = ILQR(compile=True, tolerance=1e-4, curvature=CurvatureBySize(), one_by_one=one_by_one)
    guess = torch.zeros(batch, STEPS, model.control_dim)

    def solve():
        return solver(Batched(model), cost, model.bounds, state, guess)

    def differentiate():
        solve().states.square().sum().backward()

    began = time.perf_counter(), os.times()
    solution = solve()
    first, after = time.perf_counter() - began[0], os.times()
    processor = sum(after[:4]) - sum(began[1][:4])
    clocked = Clocked(limit_s)
    with torch.no_grad():
        alone, inside = clocked(solve)
    differentiate()
    more = clocked(differentiate)[0] - alone
    kind = "library" if one_by_one else "kernels on tensors"
    iterations = float(solution.iterations.double().mean())
    cells = (
        *(f"{MODELS[name].__name__} {vehicle}, {kind}", str(batch), f"{alone / batch:.3f}"),
        *(f"{inside / batch:.3f}", f"{more / batch:.3f}", f"{more / alone:.0%}"),
        *(f"{float(solution.converged.double().mean()):.3f}", f"{iterations:.1f}"),
        *(f"{first:.0f}", f"{processor:.0f}"),
    )
    print(f"| {' | '.join(cells)} |".replace("nan", "-"), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS))
    parser.add_argument("--vehicle", default="bicycle")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 64, 256])
    parser.add_argument("--limit", type=float, default=10.0, help="seconds of repetitions per cell")
    parser.add_argument("--kernels", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"T = {STEPS}, float32, tolerance 1e-4, one thread; processor time in ms, median of up to 100 solves. `in the "
        "library`: the part without the checks of the arguments and the search for the library. First call, with its "
        "gradient: seconds that passed, and seconds of the processor with those of the C++ compiler; with libraries that "
        "are kept on disk neither counts.\n"
    )
    print(f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|", sep="\n")
    for name in arguments.models:
        for one_by_one in (4096, 0) if arguments.kernels else (4096,):
            for batch in arguments.batches:
                measure(name, arguments.vehicle, batch, one_by_one, arguments.limit)


if __name__ == "__main__":
    main()
