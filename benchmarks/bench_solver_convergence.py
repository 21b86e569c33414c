"""Convergence table: status of 1,000 random problems, and costs beside IPOPT's and the best known.

    python benchmarks/bench_solver_convergence.py > benchmarks/results/convergence.md

Needs the reference solutions in ../shared, see tests/control/test_reference.py, which holds the numbers.
"""

import argparse
import time

import numpy as np
import torch
from bench_solver_gradients import ROOT, reference

from diffstack_mmv.control import ILQR, Batched, Bounds
from tests.control import test_linear_quadratic, test_reference

CLOSE = 1 + 1e-4


def in_precision(problem, dtype):
    """The problem of `test_reference.posed` in another precision."""
    *callables, box, states = problem
    narrow = [Batched(part.function, *(t.to(dtype) for t in part.tensors)) for part in callables]
    return *narrow, Bounds(*(bound.to(dtype) for bound in box)), states.to(dtype)


def statuses(given, name, dtype, count):
    """Share converged of random problems from zero controls, NaNs, and iterations."""
    module, _ = given
    problem = in_precision(
        test_reference.posed(module, name, module.instances(name, count, seed=7)), dtype
    )
    solution = ILQR()(*problem, torch.zeros(count, 30, 2, dtype=dtype))
    numbers = sum(int(part.isnan().sum()) for part in solution)
    steps = solution.iterations.double()
    return solution.converged.double().mean(), numbers, steps.median(), steps.quantile(0.99)


def costs(given, name, dtype, levels):
    """Cheapest true cost of each of the 256 reference problems from constant controls."""
    module, _ = given
    instances = module.instances(name)
    problem = in_precision(test_reference.posed(module, name, instances), dtype)
    found = []
    for level in levels(*problem[2]):
        solution = ILQR()(*problem, level.expand(256, 30, 2).to(dtype))
        controls = solution.controls.double().numpy()
        found.append(module.true_cost(name, instances["x0"], instances["p"], controls)[0])
    return np.stack(found)


def published():
    """The 128 bounded LQR problems of acados' differentiable NMPC paper, in float64."""
    print("\n128 published LQR problems with four controls, T = 20, unstable, tolerance 1e-16.\n")
    print(
        "| problems | bounds active | solved to 1e-7 | converged | largest error of the controls "
        "| largest residual | iterations: mean | most | s, eager |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name in ("test_umax1", "test_umax10000", "second_umax1", "second_umax10000"):
        folder = ROOT.parent / "shared" / "reference" / "mpc" / "acados_lqr"
        file = dict(np.load(folder / f"reference_{name}.npz"))
        problem = test_linear_quadratic.published_problem(file)
        start = time.process_time()
        solution = test_linear_quadratic.solved(problem, float(file["u_max"]))
        seconds, steps = time.process_time() - start, solution.iterations.double()
        error = np.abs(solution.controls.numpy() - file["u"]).max((1, 2))
        print(
            f"| {name} | {np.mean(file['active'] != 0):.1%} | {np.sum(error < 1e-7)} "
            f"| {solution.converged.sum()} | {error.max():.1e} | {solution.residual.max():.1e} "
            f"| {steps.mean():.1f} | {steps.max():.0f} | {seconds:.2f} |",
            flush=True,
        )


def main(count):
    given = reference()
    print(f"{count:,} random problems (seed 7), T = 30, from zero controls.\n")
    print("| problem | precision | converged | NaN | iterations: median | iterations: 99 % |")
    print("|---|---|---|---|---|---|")
    for name in test_reference.PROBLEMS:
        for dtype in (torch.float32, torch.float64):
            share, numbers, middle, high = statuses(given, name, dtype, count)
            kind = str(dtype).removeprefix("torch.")
            print(
                f"| {name} | {kind} | {share:.1%} | {numbers} | {middle:.0f} | {high:.0f} |",
                flush=True,
            )
    print("\n256 reference problems: share within 1e-4 relative cost of the other, or cheaper.\n")
    print(
        "| problem | precision | zero start against IPOPT from the same start "
        "| zero start against the best known | IPOPT's zero start against the best known "
        "| ten starts against the best known |"
    )
    print("|---|---|---|---|---|---|")
    for name in test_reference.PROBLEMS:
        file = given[1](f"reference_{name}")
        best, start = file["J"] * CLOSE, file["J_start0"]
        for dtype in (torch.float32, torch.float64):
            found = costs(given, name, dtype, test_reference.start_levels)
            zero, many = found[0], found.min(0)
            shares = (zero <= start * CLOSE, zero <= best, start <= best, many <= best)
            cells = " | ".join(f"{share.mean():.1%}" for share in shares)
            print(f"| {name} | {str(dtype).removeprefix('torch.')} | {cells} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000, help="random problems")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    main(arguments.count)
    published()
