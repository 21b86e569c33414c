"""128 bounded LQRs, the published benchmark of acados' differentiable solver: time and accuracy per core.

    python benchmarks/bench_lqr.py ../shared/reference/mpc/acados_lqr > benchmarks/results/lqr.md
    python benchmarks/bench_lqr.py FOLDER --hpipm PREFIX     # where blasfeo and hpipm are installed: lib, include
    python benchmarks/bench_lqr.py FOLDER --packages FOLDER  # of the peers that are Python packages

Processor time of one thread, the smallest of the repetitions. A peer that is not installed is skipped and said to be.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds

STEPS, N, M = 20, 8, 4
SETS = ("test_umax10000", "test_umax1", "second_umax1")
SOLVED = 1e-7  # largest error of a control of a solved problem


def fastest(work, limit_s=20.0, most=10):
    """Smallest processor time of the repetitions after the first call, in ms, and the last result."""
    result, times, began = work(), [], time.monotonic()
    while not times or (len(times) < most and time.monotonic() - began < limit_s):
        start = time.process_time()
        result = work()
        times.append(1e3 * (time.process_time() - start))
    return min(times), result


def linear(of_state, of_control, offset):
    """Dynamics that all problems share."""

    def dynamics(state, control):
        moved = (of_state * state.unsqueeze(-2)).sum(-1)
        return moved + (of_control * control.unsqueeze(-2)).sum(-1) + offset

    return Batched(dynamics)


def quadratic(hessian):
    """Cost that all problems share."""

    def cost(states, controls):
        both = torch.cat([states, controls], -1)
        return 0.5 * ((both.unsqueeze(-2) * hessian).sum(-1) * both).sum(-1)

    return Batched(cost)


def ours(file, **settings):
    """Time of the solution, with the adjoint, controls, and the gradient of the published loss."""
    A, B, b, H, start = (torch.tensor(file[key]) for key in ("A", "B", "b", "H", "x0"))
    leaves = [each.requires_grad_() for each in (A, B, b, H)]
    limit = torch.full((M,), float(file["u_max"]), dtype=start.dtype)
    solver, guess = ILQR(**settings), start.new_zeros(len(start), STEPS, M)

    def solve():
        return solver(linear(A, B, b), quadratic(H), Bounds(-limit, limit), start, guess)

    def differentiate():
        return torch.autograd.grad(solve().controls[:, 0].sum(), leaves)

    with torch.no_grad():
        alone, solution = fastest(solve)
    both, slopes = fastest(differentiate)
    columns = [each.T.flatten() if each.dim() == 2 else each for each in slopes]
    return alone, both, solution.controls.numpy(), torch.cat(columns).numpy()


def compiled(file, arguments):
    """Each problem in the generated library."""
    return ours(file, compile=True, one_by_one=1000, tolerance=1e-14, max_iterations=300)


def eager(file, arguments):
    """All as one batch, in eager tensors."""
    return ours(file, tolerance=1e-14, max_iterations=300)


def hpipm(file, arguments):
    """HPIPM, the solver inside of acados, with the tightest tolerance at which it converges."""
    prefix = arguments.hpipm
    if prefix is None:
        raise ModuleNotFoundError("hpipm")
    given = (file["A"].T, file["B"].T, file["b"], file["x0"])
    flat = "\n".join(map(repr, np.concatenate([part.ravel() for part in given]).tolist()))
    tolerance = 1e-10 if "test" in arguments.name else 1e-8
    head = f"{STEPS} {N} {M} {len(file['x0'])} {float(file['u_max'])} {tolerance} 2\n"
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(folder, "hpipm"))
        source = Path(__file__).parent / "peers" / "hpipm.c"
        command = ["gcc", "-O2", "-march=native", str(source), f"-I{prefix}/include"]
        command += [f"-L{prefix}/lib", "-lhpipm", "-lblasfeo", "-lm", "-o", program]
        subprocess.run(command, check=True)
        done = subprocess.run(
            [program], input=head + flat, capture_output=True, text=True, check=True
        )
    alone, both, *rest = map(float, done.stdout.split())
    return alone, both, np.array(rest[2:]).reshape(-1, STEPS, M), None


def by_casadi(plugin, **options):
    """A solver of sparse quadratic programs in CasADi."""

    def solve(file, arguments):
        import casadi

        count, limit = len(file["x0"]), float(file["u_max"])
        width = M + N
        rows = np.zeros((STEPS * N, STEPS * width))  # stages (u_t, x_t+1)
        for t in range(STEPS):
            block = rows[t * N : (t + 1) * N]
            block[:, t * width : t * width + M] = -file["B"]
            block[:, t * width + M : (t + 1) * width] = np.eye(N)
            if t:
                block[:, (t - 1) * width + M : t * width] = -file["A"]
        H, A = casadi.DM.eye(STEPS * width), casadi.sparsify(casadi.DM(rows))
        qp = casadi.conic("qp", plugin, {"h": H.sparsity(), "a": A.sparsity()}, options)
        low = np.tile(np.r_[np.full(M, -limit), np.full(N, -np.inf)], STEPS)
        offsets = np.tile(file["b"], (count, STEPS))
        offsets[:, :N] += file["x0"] @ file["A"].T

        def all_of_them():
            solutions = [
                qp(h=H, a=A, lba=offset, uba=offset, lbx=low, ubx=-low)["x"].full().ravel()
                for offset in offsets
            ]
            return np.array(solutions).reshape(count, STEPS, width)[..., :M]

        return *(fastest(all_of_them, 10.0, 3)), None

    def row(file, arguments):
        alone, controls, slopes = solve(file, arguments)
        return alone, None, controls, slopes

    return row


def mpc_pytorch(file, arguments):
    """The package mpc: all problems as one batch, through its analytic gradient."""
    from mpc import mpc

    A, B, b, H, start = (torch.tensor(file[key]) for key in ("A", "B", "b", "H", "x0"))
    count, limit = len(start), float(file["u_max"])
    leaves = [each.requires_grad_() for each in (A, B, b, H)]

    def solve():
        F, f = torch.cat([A, B], 1).expand(STEPS, count, -1, -1), b.expand(STEPS, count, -1)
        C, c = H.expand(STEPS + 1, count, -1, -1), start.new_zeros(STEPS + 1, count, N + M)
        solver = mpc.MPC(
            N, M, STEPS + 1, u_lower=-limit, u_upper=limit, lqr_iter=50, eps=1e-10, n_batch=count,
            verbose=-1, exit_unconverged=False, detach_unconverged=False, backprop=True,
        )  # fmt: skip
        return solver(start, mpc.QuadCost(C, c), mpc.LinDx(F, f))[1]

    def differentiate():
        return torch.autograd.grad(solve()[0].sum(), leaves)

    with torch.no_grad():
        alone, controls = fastest(solve, 5.0, 3)
    both, slopes = fastest(differentiate, 5.0, 3)
    columns = [each.T.flatten() if each.dim() == 2 else each for each in slopes]
    return alone, both, controls[:-1].movedim(0, 1).numpy(), torch.cat(columns).numpy()


SOLVERS = {
    "ours, compiled one by one": compiled,
    "ours, eager batch": eager,
    "HPIPM (inside of acados)": hpipm,
    "DAQP (CasADi)": by_casadi("daqp"),
    "OSQP (CasADi)": by_casadi(
        "osqp", osqp={"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 50000, "verbose": False}
    ),
    "mpc.pytorch": mpc_pytorch,
}


def row(name, found, file):
    """A line of the table."""
    alone, both, controls, slopes = found
    error = np.abs(controls - file["u"]).max((1, 2))
    cells = [name, f"{alone:.1f}", "-" if both is None else f"{both:.1f}"]
    cells += [f"{np.sum(error < SOLVED)}", f"{np.nanmax(error):.0e}"]
    exact = file["dtheta_sum"]
    relative = None if slopes is None else np.abs(slopes - exact).max() / np.abs(exact).max()
    return " | ".join([*cells, "-" if relative is None else f"{relative:.0e}"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="with the reference solutions")
    parser.add_argument("--hpipm", type=Path, help="prefix with lib and include")
    parser.add_argument("--packages", type=Path, help="folder with packages of peers")
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS))
    arguments = parser.parse_args()
    if arguments.packages:
        sys.path.append(str(arguments.packages))
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    print(
        "128 bounded LQRs (N = 20, 8 states, 4 controls; acados' differentiable NMPC paper), float64, one core; processor "
        f"time for all, smallest of the repetitions. Solved: all controls within {SOLVED:g}. `adjoint`: with the gradient of "
        "Σ u_0 by A, B, b, H; of HPIPM only its linear system.\n"
    )
    print(
        "| set | solver | solution, ms | with adjoint, ms | solved | largest error | gradient, relative error |"
    )
    print("|---|---|---|---|---|---|---|")
    for arguments.name in SETS:
        file = np.load(arguments.folder / f"reference_{arguments.name}.npz")
        for name in arguments.solvers:
            try:
                found = SOLVERS[name](file, arguments)
            except ModuleNotFoundError as missing:
                print(f"| {arguments.name} | {name} | not installed: {missing.name} | | | | |")
                continue
            print(f"| {arguments.name} | {row(name, found, file)} |", flush=True)
    print(f"\nLoad of the machine at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.")


if __name__ == "__main__":
    main()
