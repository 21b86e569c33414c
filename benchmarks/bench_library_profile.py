"""Where the time of a single compiled solve goes, beside the operations that have to be done.

    python benchmarks/bench_library_profile.py > benchmarks/results/library_profile.md

The library is built a second time with clocks around its parts. Floor: the operations of the generated functions and
the products of matrices, counted from the program, at the rate of a matrix product in this process.
"""

import ctypes
import functools
import time

import torch
from bench_models import MODELS, STEPS, problem
from bench_solver_profile import rates

from diffstack_mmv.control import ILQR, Batched, CurvatureBySize
from diffstack_mmv.control.native import solver as native
from diffstack_mmv.control.native.derived import derived
from diffstack_mmv.control.native.generation import LANES, is_short, source
from diffstack_mmv.control.native.scalar import needed
from diffstack_mmv.vehicles import load_vehicle
from dmmv_conventions.libraries import load

PARTS = ("expand", "recursion", "search")
TITLES = (
    "local model: values, slopes, curvature",
    "Riccati recursion",
    "roll-outs of all step sizes",
)
RUNS = 200
SECONDS = """
#pragma GCC visibility push(default)
extern "C" double* dmmv_seconds() { return dmmv::Timed::seconds; }
#pragma GCC visibility pop
"""


def clocked(written):
    """The same source with clocks."""

    def source_with_clocks(problem, library, real):
        return "#define DMMV_CLOCK\n" + written(problem, library, real) + SECONDS

    return source_with_clocks


def operations(problem):
    """Operations per iteration of each part, of a curvature at every iteration."""
    n, m, steps, _ = problem.sizes

    def count(stage, nodes):
        return len(needed(stage.program, nodes))

    def local(each):
        program = each.stage.program
        columns = -(-len(each.active) // LANES)
        slopes = count(each.stage, each.gradient)
        with_columns = slopes * (1 + 2 * LANES * columns)
        hessian = each.hessian
        short = hessian and is_short(program, hessian, each.gradient)
        curvature = count(each.stage, hessian) if short else with_columns
        jacobian = 0 if each.stage.is_cost else count(each.stage, each.jacobian)
        return curvature + jacobian

    step = derived(problem.step, problem.sizes)
    costs = [derived(cost, problem.sizes) for cost in problem.costs]
    each = [costs[kind] for kind in problem.kinds]
    values = steps * count(step.stage, step.stage.outputs)
    values += sum(count(cost.stage, cost.stage.outputs) for cost in each)
    recursion = 2 * (2 * n**3 + 3 * n * n * m + 4 * n * m * m) + 12 * m**3
    return {
        "expand": steps * local(step) + sum(map(local, each)),
        "recursion": steps * recursion,
        "search": LANES * (values + 2 * steps * n * m),
    }


def measure(name, compute):
    """The lines of one model."""
    model = MODELS[name](load_vehicle("bicycle"))
    cost, state = problem(model, 1)
    solver = ILQR(compile=True, tolerance=1e-4, curvature=CurvatureBySize())
    guess = torch.zeros(1, STEPS, model.control_dim)
    seen, library_s = [], [0.0]

    def spied(taken, *rest):
        seen[:] = [taken.problem]
        start = time.process_time()
        solution = native_solved(taken, *rest)
        library_s[0] += time.process_time() - start
        return solution

    native_solved, native.solved = native.solved, spied
    with torch.no_grad():
        solution = solver(Batched(model), cost, model.bounds, state, guess)
        staged = seen[0]
        library = load(native.source(staged, "solve", "float"))
        library.dmmv_seconds.restype = ctypes.POINTER(ctypes.c_double)
        seconds = library.dmmv_seconds()
        before, library_s[0], began = list(seconds[: len(PARTS)]), 0.0, time.process_time()
        for _ in range(RUNS):
            solver(Batched(model), cost, model.bounds, state, guess)
        whole = 1e3 * (time.process_time() - began) / RUNS
    native.solved = native_solved
    iterations, counted = int(solution.iterations), operations(staged)
    inside = 0.0
    for number, (part, title) in enumerate(zip(PARTS, TITLES, strict=True)):
        spent = 1e3 * (seconds[number] - before[number]) / RUNS
        floor = 1e3 * iterations * counted[part] / compute
        inside += spent
        print(
            f"| {MODELS[name].__name__} | {title} | {spent:.3f} | {spent / whole:.0%} | {iterations * counted[part] / 1e6:.2f} "
            f"| {floor:.3f} | {spent / floor:.1f} |"
        )
    called = 1e3 * library_s[0] / RUNS
    for title, spent in (
        ("the rest of the call of the library", called - inside),
        (
            "checks of the arguments, search for the library, gradients' book-keeping",
            whole - called,
        ),
    ):
        print(f"| {MODELS[name].__name__} | {title} | {spent:.3f} | {spent / whole:.0%} | | | |")
    print(
        f"| {MODELS[name].__name__} | all, {iterations} iterations | {whole:.3f} | | | | |",
        flush=True,
    )


def main():
    torch.set_num_threads(1)
    native.source = functools.wraps(source)(clocked(source))
    compute, _ = rates()
    print(
        f"One problem, T = {STEPS}, float32, one thread; mean of {RUNS} solves. Floor: operations at {compute / 1e9:.0f} Gflop/s, the rate "
        "of a matrix product in this process, which chains of scalar operations, quotients and sines cannot reach.\n"
    )
    print(
        "| model | part | ms | share | Mflop | floor, ms | ms / floor |\n|---|---|---|---|---|---|---|"
    )
    for name in MODELS:
        measure(name, compute)


if __name__ == "__main__":
    main()
