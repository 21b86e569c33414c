"""Constrained solver: gradients against central differences, and 1,000 random drives beside IPOPT and fatrop.

    python benchmarks/bench_constrained.py > benchmarks/results/constrained.md

Takes about four minutes of one core. `--count` sets the number of drives.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]
from diffstack_mmv.control import ILQR, SolverStatus  # noqa: E402
from diffstack_mmv.control.constrained import ConstrainedILQR  # noqa: E402
from diffstack_mmv.control.constrained.local import rollout  # noqa: E402
from tests.control.constrained import problems, test_gradient  # noqa: E402

EXACT = ConstrainedILQR(ILQR(tolerance=1e-16))
STEP = 1e-5


def loosened(drive):
    """The same drives with every constraint out of reach."""
    far = drive.centre + 100
    return drive._replace(centre=far, top_speed=drive.top_speed + 50, grip=drive.grip + 50)


def differences(drive, name, start):
    """Relative error of the derivative of each drive along a random direction."""
    count, warm = len(drive.state), (start.controls, start.multipliers)
    hidden = getattr(drive, name).clone().requires_grad_()
    found = test_gradient.functional(problems.solve(EXACT, drive._replace(**{name: hidden}), *warm))
    gradient = torch.autograd.grad(found.sum(), hidden)[0]
    direction = torch.randn(hidden.shape, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        ends = [
            test_gradient.functional(
                problems.solve(EXACT, drive._replace(**{name: hidden + s * direction}), *warm)
            )
            for s in (STEP, -STEP)
        ]
    expected = (ends[0] - ends[1]) / (2 * STEP)
    along = (gradient * direction).reshape(count, -1).sum(1)
    scale = expected.abs() + 1e-3 * found.detach().abs()
    return ((along - expected).abs() / scale).numpy()


def gradients(count):
    print("Relative error of the gradient against central differences along a random direction,")
    print("float64, all outputs (states, controls, cost, multipliers) at once.\n")
    print("| by | free: median | free: largest | active: median | active: largest |")
    print("|---|---|---|---|---|")
    cases = []
    for drive in (loosened(problems.drives(count)), problems.drives(count)):
        with torch.no_grad():
            cases.append((drive, problems.solve(EXACT, drive, problems.braking(drive))))
    for name in problems.Drive._fields:
        cells = []
        for drive, start in cases:
            errors = differences(drive, name, start)[start.converged.numpy()]
            cells += [f"{np.median(errors):.1e}", f"{errors.max():.1e}"]
        print(f"| {name} | {' | '.join(cells)} |")
    pressing = sum((m > 1e-6).sum((-2, -1)) for m in cases[1][1].multipliers).double()
    print(
        f"\n{count} drives each; active: {pressing.mean():.0f} rows of constraints press on average, "
    )
    print("besides bounds of the controls.\n")


def weakly_active():
    """A wall exactly where the cart ends without it: derivative by the goal of the final place."""
    from diffstack_mmv.control import Bounds
    from diffstack_mmv.control.constrained import Inequality

    box = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))

    def ended(goal, wall):
        def cost(states, forces):
            return (states[..., 0] - goal).square() + 0.01 * forces[..., 0].square()

        limits = [Inequality(lambda states, forces: states[..., :1] - wall)]
        start = torch.zeros(2), torch.zeros(15, 1)
        return EXACT(test_gradient.cart, cost, limits, box, *start).states[:, 0].max()

    goal = torch.tensor(3.0, requires_grad=True)
    wall = ended(goal.detach(), torch.tensor(1e3)).detach()
    found = torch.autograd.grad(ended(goal, wall), goal)[0]
    sides = [(ended(goal.detach() + s, wall) - wall) / s for s in (-STEP, STEP)]
    print("| weakly active | derivative | difference to the inside | difference to the wall |")
    print("|---|---|---|---|")
    print(f"| farthest place by the goal | {found:.8f} | {sides[0]:.8f} | {sides[1]:.8f} |\n")


def told(title, drive, guess, solver, once):
    """The solution, after a table of its statuses, accuracy and time."""
    count = len(drive.state)
    with torch.no_grad():
        if once:  # libraries are built
            few = problems.drives(2)
            problems.solve(once, few, problems.braking(few))
        began = time.process_time()
        solution = problems.solve(solver, drive, guess)
        spent = time.process_time() - began
    converged = solution.converged
    names = Counter(SolverStatus(int(status)).name for status in solution.status)
    print(f"\n{title}:\n")
    print("| status | problems |\n|---|---|")
    for name, number in names.most_common():
        print(f"| {name} | {number} |")
    steps = solution.iterations.double()
    print("\n| of the converged | |\n|---|---|")
    print(f"| largest violation | {solution.violation[converged].max():.1e} |")
    print(f"| violation ≤ 1e-6 | {(solution.violation[converged] <= 1e-6).double().mean():.1%} |")
    print(f"| largest residual | {solution.residual[converged].max():.1e} |")
    print(
        f"| iterations: median, 99 %, most | {steps.median():.0f}, {steps.quantile(0.99):.0f}, {steps.max():.0f} |"
    )
    print(f"| CPU time per problem, one batch | {1e3 * spent / count:.1f} ms |")
    return solution


def robustness(count, compared):
    drive = problems.drives(count)
    guess = problems.braking(drive)
    print(
        f"{count} random drives (T = 30, three moving discs, speed limit, friction circle, box), from braking."
    )
    library = ILQR(compile=True, one_by_one=5000)
    quick = ConstrainedILQR(library, persistent=False)
    eager = told("Eager", drive, guess, ConstrainedILQR(ILQR()), None)
    whole = told(
        "Compiled: rounds in a library, the rest as eager",
        drive,
        guess,
        ConstrainedILQR(library),
        quick,
    )
    told("Compiled, the rounds alone (`persistent=False`)", drive, guess, quick, None)
    beside_ipopt(drive, guess, {"eager": eager, "compiled": whole}, compared)


def beside_ipopt(drive, guess, solutions, compared):
    from tests.control.constrained.reference import by_ipopt

    states = rollout(lambda x, u: problems.step(x, u, drive.wheelbase), drive.state, guess).numpy()
    began = time.process_time()
    found = [by_ipopt(drive, i, guess[i].numpy(), states[i]) for i in range(compared)]
    spent = time.process_time() - began
    theirs = np.array([one.solved for one in found])
    print(f"\nBeside IPOPT (CasADi, same guess, {compared} of the drives):\n")
    print("| | " + " | ".join(solutions) + " |\n|---" + "|---" * len(solutions) + "|")
    columns = [compare(each, compared, theirs, found) for each in solutions.values()]
    for title, *cells in zip(ROWS, *columns, strict=True):
        print(f"| {title} | {' | '.join(cells)} |")
    print(f"\nCPU time per problem of IPOPT: {1e3 * spent / compared:.1f} ms.")
    for name, solution in solutions.items():
        other = theirs & ~solution.converged[:compared].numpy()
        print(f"Solved by IPOPT alone, {name}: {np.flatnonzero(other).tolist()}.")
    beside_fatrop(drive, guess, states, found, solutions["compiled"])


def beside_fatrop(drive, guess, states, by_ipopt, compiled):
    """A method that knows the stages, as ours does, from the same guess."""
    from peers.fatrop_drives import by_fatrop

    by_fatrop(drive, 0, guess[0].numpy(), states[0])  # builds it
    began = time.process_time()
    found = [by_fatrop(drive, i, guess[i].numpy(), states[i]) for i in range(len(by_ipopt))]
    spent = time.process_time() - began
    theirs = np.array([one.solved for one in found])
    cost = np.array([one.cost for one in found])
    print(f"\nBeside fatrop (CasADi, same guess, tolerance 1e-6, {len(found)} of the drives):\n")
    print("| fatrop solved | beside | same cost within 1e-5 | fatrop cheaper |\n|---|---|---|---|")
    ours = compiled.converged[: len(found)].numpy(), compiled.cost[: len(found)].numpy()
    ipopt = np.array([one.solved for one in by_ipopt]), np.array([one.cost for one in by_ipopt])
    for name, (solved, other) in {"IPOPT": ipopt, "ours compiled": ours}.items():
        ratio = (cost / other)[theirs & solved]
        same, less = (abs(ratio - 1) <= 1e-5).mean(), (ratio < 1 - 1e-5).mean()
        print(f"| {theirs.sum()} | {name}: {solved.sum()} solved | {same:.1%} | {less:.1%} |")
    print(f"\nCPU time per problem of fatrop: {1e3 * spent / len(found):.1f} ms.")


ROWS = (
    *("solved by both, by ours alone, by IPOPT alone, by none", "same cost within 1e-6"),
    *("ours cheaper (another local optimum)", "IPOPT cheaper", "ours / IPOPT: median, mean"),
)


def compare(solution, compared, theirs, found):
    """The cells of one solution, in the order of `ROWS`."""
    ours = solution.converged[:compared].numpy()
    ratio = solution.cost[:compared].numpy() / np.array([one.cost for one in found])
    both = ratio[ours & theirs]
    counts = ours & theirs, ours & ~theirs, ~ours & theirs, ~ours & ~theirs
    return (
        ", ".join(str(each.sum()) for each in counts),
        f"{(abs(both - 1) <= 1e-6).mean():.1%}",
        f"{(both < 1 - 1e-6).mean():.1%}",
        f"{(both > 1 + 1e-6).mean():.1%}",
        f"{np.median(both):.6f}, {both.mean():.4f}",
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--compared", type=int, default=1000)
    chosen = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    print("# Constraints on states and controls\n")
    gradients(32)
    weakly_active()
    robustness(chosen.count, min(chosen.compared, chosen.count))


if __name__ == "__main__":
    main()
