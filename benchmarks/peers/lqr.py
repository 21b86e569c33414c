"""Peers on the bounded LQRs of bench_lqr.py: time, time with the adjoint, controls, gradient."""

import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from peers import lqr_convex, lqr_stages
from peers.times import STEPS, M, Measured, N, fastest


def in_c(program, library, settings):
    """A program of this folder that is linked with an installed solver.

    Args:
        program: Its name.
        library: What it is linked with besides.
        settings: Tolerance and mode for each set: the fastest with which all are solved.
    """

    def row(file, arguments):
        prefix = arguments.hpipm
        if prefix is None:
            raise ModuleNotFoundError(program, name=program)
        given = (file["A"].T, file["B"].T, file["b"], file["x0"])
        flat = "\n".join(map(repr, np.concatenate([part.ravel() for part in given]).tolist()))
        tolerance, mode = settings[arguments.name]
        head = f"{STEPS} {N} {M} {len(file['x0'])} {float(file['u_max'])} {tolerance} {mode}\n"
        include = [
            f"-I{prefix}/include{each}" for each in ("", "/blasfeo/include", "/hpipm/include")
        ]
        with tempfile.TemporaryDirectory() as folder:
            binary, source = str(Path(folder, program)), Path(__file__).parent / f"{program}.c"
            command = ["gcc", "-O2", "-march=native", str(source), *include]
            command += [f"-L{prefix}/lib", *library, "-lhpipm", "-lblasfeo", "-lm", "-o", binary]
            command += ["-Wl,--unresolved-symbols=ignore-in-shared-libs"]
            subprocess.run(command, check=True, capture_output=True)
            done = subprocess.run(
                [binary],
                input=head + flat,
                capture_output=True,
                text=True,
                check=True,
                env=os.environ | {"LD_LIBRARY_PATH": f"{prefix}/lib"},
            )
        alone, both, *rest = map(float, done.stdout.split())
        return Measured(alone, np.array(rest[2:]).reshape(-1, STEPS, M), both)

    return row


def by_casadi(plugin, **options):
    """A solver of sparse quadratic programs in CasADi; what it does not solve counts as it is."""
    options |= {"error_on_fail": False}

    def row(file, arguments):
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

        return Measured(*fastest(all_of_them, 10.0, 3))

    return row


def mpc_pytorch(file, arguments):
    """The package mpc: all problems as one batch, through its analytic gradient."""
    import torch
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
    found = controls[:-1].movedim(0, 1).numpy()
    return Measured(alone, found, both, torch.cat(columns).numpy())


def qpth(file, arguments):
    """The package qpth: dense quadratic programs in the controls, one batch."""
    import torch
    from qpth.qp import QPFunction

    A, B, b, H, start = (torch.tensor(file[key]) for key in ("A", "B", "b", "H", "x0"))
    leaves = [each.requires_grad_() for each in (A, B, b, H)]
    wide = STEPS * M
    box, none = torch.cat([torch.eye(wide), -torch.eye(wide)]), torch.Tensor()
    limits = torch.full((2 * wide,), float(file["u_max"]))

    def solve():
        states, inputs = [start], [torch.zeros(N, wide)]
        for t in range(STEPS):
            states.append(states[-1] @ A.T + b)
            placed = torch.nn.functional.pad(B, (t * M, wide - (t + 1) * M))
            inputs.append(A @ inputs[-1] + placed)
        free, slope = torch.stack(states, 1), torch.stack(inputs)
        Q, R, S = H[:N, :N], H[N:, N:], H[:N, N:]
        hessian = torch.einsum("tip,ij,tjq->pq", slope, Q, slope) + torch.block_diag(*[R] * STEPS)
        cross = torch.einsum("tip,tij->ptj", slope[:-1], S.expand(STEPS, N, M)).reshape(wide, wide)
        linear = torch.einsum("cti,ij,tjp->cp", free, Q, slope)
        linear = linear + (free[:, :-1] @ S).flatten(1)
        found = QPFunction(eps=1e-11, verbose=-1, maxIter=60)(
            # one for each problem: the gradient of what they share is a mean there
            (hessian + cross + cross.T).expand(len(start), -1, -1),
            linear,
            box,
            limits,
            none,
            none,
        )
        return found.reshape(-1, STEPS, M)

    def differentiate():
        return torch.autograd.grad(solve()[:, 0].sum(), leaves)

    with torch.no_grad():
        alone, controls = fastest(solve, 5.0, 3)
    both, slopes = fastest(differentiate, 5.0, 3)
    columns = [each.T.flatten() if each.dim() == 2 else each for each in slopes]
    return Measured(alone, controls.numpy(), both, torch.cat(columns).numpy())


HPIPM = {"test_umax10000": (1e-10, 1), "test_umax1": (1e-10, 1), "second_umax1": (1e-8, 2)}
ACADOS = {"test_umax10000": (1e-6, 5), "test_umax1": (1e-10, 4), "second_umax1": (1e-8, 2)}
SOLVERS = {
    "acados' QP module, partial condensing": in_c("acados", ("-lacados",), ACADOS),
    "HPIPM (inside of acados)": in_c("hpipm", (), HPIPM),
    **lqr_stages.SOLVERS,
    "DAQP (CasADi)": by_casadi("daqp"),
    "mpc.pytorch": mpc_pytorch,
    "qpth": qpth,
    **lqr_convex.SOLVERS,
}
