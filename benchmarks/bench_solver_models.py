"""Solve and gradient times of the package's own dynamics models, compiled.

    python benchmarks/bench_solver_models.py > benchmarks/results/solver_models.md

The problems of bench_solver.py with the dynamics replaced: the cost sees the model's motion.
"""

import argparse
import os
import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))
from bench_solver_worker import fastest  # noqa: E402
from peers import driving, ours  # noqa: E402

from diffstack_mmv.control import ILQR, Batched, DifferencedCurvature, ExactCurvature  # noqa: E402
from diffstack_mmv.dynamics import DiffGM3, DiffKBM  # noqa: E402
from diffstack_mmv.types import Motion  # noqa: E402
from diffstack_mmv.vehicles import load_vehicle  # noqa: E402

MODELS = {"kbm": DiffKBM, "gm3": DiffGM3}


def problem(model, batch, steps):
    """Cost and initial state of `batch` problems."""
    states, parameters = (
        torch.tensor(part, dtype=torch.float32) for part in driving.instances(batch, steps)
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


def measure(name, vehicle, batch, steps, compiled, curvature, limit_s):
    """One row."""
    model = MODELS[name](load_vehicle(vehicle))
    cost, state = problem(model, batch, steps)
    solver = ILQR(compile=compiled, tolerance=1e-4, curvature=curvature)
    guess = torch.zeros(batch, steps, model.control_dim)

    def solve():
        return solver(Batched(model), cost, model.bounds, state, guess)

    with torch.no_grad():
        first, forward, solution = fastest(solve, limit_s)

    def differentiate():
        solve().states.square().sum().backward()

    # all that a gradient adds to a solve, the exact local model included
    backward = fastest(differentiate, limit_s, 3)[1] - forward
    share = float(solution.converged.double().mean())
    mean = float(solution.iterations.double().mean())
    kind = "compiled" if compiled else "eager"
    kind += ", curvature by differences" if curvature == DifferencedCurvature() else ""
    print(
        f"| {MODELS[name].__name__} {vehicle}, {kind} | {batch} | {1e3 * forward / batch:.3f} "
        f"| {1e3 * backward:.1f} | {backward / forward:.2f} | {share:.3f} | {mean:.1f} | {first:.0f} "
        f"| {os.getloadavg()[0]:.1f} |",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS))
    parser.add_argument("--vehicle", default="bicycle")
    parser.add_argument("--batches", type=int, nargs="+", default=[256, 64])
    parser.add_argument("--steps", type=int, default=30)
    parser.add_argument("--limit", type=float, default=20.0, help="seconds of repetitions per row")
    parser.add_argument("--eager", action="store_true")
    parser.add_argument("--differences", action="store_true", help="DifferencedCurvature")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(f"T = {arguments.steps}, float32, tolerance 1e-4, one thread, processor time.\n")
    print("| model | batch | ms per problem | a gradient adds, ms | share of the solve | converged "
          "| iterations: mean | first call s | load of the machine |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    curvature = DifferencedCurvature() if arguments.differences else ExactCurvature()
    for name in arguments.models:
        for batch in arguments.batches:
            measure(
                name,
                arguments.vehicle,
                batch,
                arguments.steps,
                not arguments.eager,
                curvature,
                arguments.limit,
            )


if __name__ == "__main__":
    main()
