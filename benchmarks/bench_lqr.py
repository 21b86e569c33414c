"""128 bounded LQRs, the published benchmark of acados' differentiable solver: time and accuracy per core.

    python benchmarks/bench_lqr.py ../shared/reference/mpc/acados_lqr > benchmarks/results/lqr.md
    python benchmarks/bench_lqr.py FOLDER --hpipm PREFIX     # where blasfeo and hpipm are installed: lib, include
    python benchmarks/bench_lqr.py FOLDER --packages FOLDER  # of the peers that are Python packages

Processor time of one thread, the smallest of the repetitions. A peer that is not installed is skipped and said to be.
"""

import argparse
import contextlib
import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parent))
from peers import lqr  # noqa: E402
from peers.times import STEPS, M, Measured, N, fastest  # noqa: E402

SETS = ("test_umax10000", "test_umax1", "second_umax1")
COMPILED = {"compile": True, "one_by_one": 1000, "tolerance": 1e-14, "max_iterations": 300}
SOLVED = 1e-7  # largest error of a control of a solved problem


def affine(state, control, of_state, of_control, offset):
    """The next state."""
    moved = (of_state * state.unsqueeze(-2)).sum(-1)
    return moved + (of_control * control.unsqueeze(-2)).sum(-1) + offset


def quadratic(states, controls, hessian):
    """The costs of all times."""
    both = torch.cat([states, controls], -1)
    return 0.5 * ((both.unsqueeze(-2) * hessian.unsqueeze(-3)).sum(-1) * both).sum(-1)


def callables(leaves, count, together):
    """Dynamics and cost that all problems share, or of each problem, with the numbers of each."""
    from diffstack_mmv.control import Batched  # not there where peers have their own packages

    *model, hessian = leaves
    if together:
        return (
            Batched(lambda state, control: affine(state, control, *model)),
            Batched(lambda states, controls: quadratic(states, controls, hessian)),
        )
    # so near to one another that the solutions are, but no two alike
    near = 1 + 1e-14 * torch.arange(count, dtype=hessian.dtype)
    own = [each * near.reshape(-1, *[1] * each.dim()) for each in leaves]
    return Batched(affine, *own[:-1]), Batched(quadratic, own[-1])


def ours(file, limit_s, together=True, **settings):
    """Time of the solution, with the adjoint, controls, and the gradient of the published loss."""
    from diffstack_mmv.control import ILQR, Bounds

    A, B, b, H, start = (torch.tensor(file[key]) for key in ("A", "B", "b", "H", "x0"))
    leaves = [each.requires_grad_() for each in (A, B, b, H)]
    limit = torch.full((M,), float(file["u_max"]), dtype=start.dtype)
    solver, guess = ILQR(**settings), start.new_zeros(len(start), STEPS, M)
    box = Bounds(-limit, limit)

    def solve():
        return solver(*callables(leaves, len(start), together), box, start, guess)

    def differentiate():
        return torch.autograd.grad(solve().controls[:, 0].sum(), leaves)

    with torch.no_grad():
        alone, solution = fastest(solve, limit_s)
    both, slopes = fastest(differentiate, limit_s)
    columns = [each.T.flatten() if each.dim() == 2 else each for each in slopes]
    return Measured(alone, solution.controls.numpy(), both, torch.cat(columns).numpy())


def compiled(file, arguments):
    """All problems in the generated library."""
    return ours(file, arguments.limit, **COMPILED)


def compiled_apart(file, arguments):
    """The same where no two problems have the same numbers."""
    return ours(file, arguments.limit, together=False, **COMPILED)


def eager(file, arguments):
    """All as one batch, in eager tensors."""
    return ours(file, arguments.limit, tolerance=1e-14, max_iterations=300)


SOLVERS = {
    "ours, compiled": compiled,
    "ours, compiled, no two dynamics alike": compiled_apart,
    "ours, eager batch": eager,
    **lqr.SOLVERS,
}


def symmetric(slopes):
    """Slopes of which those by H, the last ones, are those of a symmetric form."""
    width = N + M
    if slopes is None or len(slopes) < width * width:
        return slopes
    others, by_hessian = np.split(slopes, [-width * width])
    by_hessian = by_hessian.reshape(width, width)
    return np.concatenate([others, 0.5 * (by_hessian + by_hessian.T).ravel()])


def row(name, found, file):
    """A line of the table."""
    error = np.abs(found.controls - file["u"]).max((1, 2))
    both = "-" if found.both_ms is None else f"{found.both_ms:.1f}"
    cells = [name, f"{found.alone_ms:.1f}", both]
    cells += [f"{np.sum(error < SOLVED)}", f"{np.nanmax(error):.0e}"]
    slopes = symmetric(found.slopes)
    exact = None if slopes is None else file["dtheta_sum"][: len(slopes)]  # some have no slope by H
    relative = None if slopes is None else np.abs(slopes - exact).max() / np.abs(exact).max()
    return " | ".join([*cells, "-" if relative is None else f"{relative:.0e}"])


def measured(name, arguments):
    """A line in a process of its own, which may be stopped."""
    python = sys.executable if name.startswith("ours") else arguments.python
    command = [python, __file__, str(arguments.folder), "--row", arguments.name, name]
    for option in ("hpipm", "packages"):
        if getattr(arguments, option):
            command += [f"--{option}", str(getattr(arguments, option))]
    command += ["--limit", str(arguments.limit)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=arguments.timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return f"{name} | stopped after {arguments.timeout:.0f} s |  |  |  | "
    lines = [line for line in done.stdout.splitlines() if line.startswith(name)]
    reason = next(iter(done.stderr.strip().splitlines()[::-1]), "no message")
    return lines[-1] if lines else f"{name} | {reason} |  |  |  | "


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="with the reference solutions")
    parser.add_argument("--hpipm", type=Path, help="prefix with lib and include")
    parser.add_argument("--packages", type=Path, help="folder with packages of peers")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the peers")
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS))
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--limit", type=float, default=20.0, help="seconds of repetitions per cell")
    parser.add_argument("--timeout", type=float, default=120.0, help="seconds per row")
    parser.add_argument("--row", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.packages:
        sys.path.append(str(arguments.packages))
    if arguments.row:
        one_row(arguments)
        return
    print(
        "128 bounded LQRs (N = 20, 8 states, 4 controls; acados' differentiable NMPC paper), float64, one core; processor "
        f"time for all, smallest of the repetitions. Solved: all controls within {SOLVED:g}. `adjoint`: with the gradient of "
        "Σ u_0 by A, B, b, H; of acados and HPIPM only its linear system, of cvxpygen and cvxpylayers without H. `times ours`: "
        "both times by those of the first row of the set.\n"
    )
    print(
        "| set | solver | solution, ms | with adjoint, ms | times ours | solved | largest error | gradient, relative error |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for chosen in arguments.sets:
        arguments.name, first = chosen, None
        for name in arguments.solvers:
            cells = measured(name, arguments).split(" | ")
            first = first or cells
            cells.insert(3, ratios(cells[1:3], first[1:3]))
            print(f"| {arguments.name} | {' | '.join(cells)} |", flush=True)


def ratios(times, others):
    """Times by other times, where both are numbers."""
    each = []
    for time, other in zip(times, others, strict=True):
        with contextlib.suppress(ValueError):
            each.append(f"{float(time) / float(other):.1f}")
    return " / ".join(each)


def one_row(arguments):
    """Measure and print one row."""
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    arguments.name, name = arguments.row
    file = np.load(arguments.folder / f"reference_{arguments.name}.npz")
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # what peers warn of
            found = SOLVERS[name](file, arguments)
    except ModuleNotFoundError as missing:
        print(f"{name} | not installed: {missing.name} |  |  |  | ")
        return
    print(row(name, found, file))


if __name__ == "__main__":
    main()
