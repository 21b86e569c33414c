"""Peers of general convex problems on the bounded LQRs: OSQP, cvxpylayers, cvxpygen. H is the identity to them."""

import contextlib
import importlib
import os
import sys
import tempfile
import types

import numpy as np

from peers.times import STEPS, M, Measured, N, fastest

WIDTH = M + N
TIGHT = {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 200_000, "verbose": False}
EXACT = {"solve_method": "Clarabel", "tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}


def sparse_program(file):
    """Constraints of one problem in the stages (u_t, x_t+1), and all right-hand sides."""
    from scipy import sparse

    rows = np.zeros((STEPS * N, STEPS * WIDTH))
    for t in range(STEPS):
        block = rows[t * N : (t + 1) * N]
        block[:, t * WIDTH : t * WIDTH + M] = -file["B"]
        block[:, t * WIDTH + M : (t + 1) * WIDTH] = np.eye(N)
        if t:
            block[:, (t - 1) * WIDTH + M : t * WIDTH] = -file["A"]
    of_controls = np.flatnonzero(np.tile(np.arange(WIDTH) < M, STEPS))
    box = sparse.eye(STEPS * WIDTH, format="csr")[of_controls]
    offsets = np.tile(file["b"], (len(file["x0"]), STEPS))
    offsets[:, :N] += file["x0"] @ file["A"].T
    return sparse.vstack([sparse.csc_matrix(rows), box], format="csc"), offsets


def osqp(file, arguments):
    """The package osqp, set up once; its adjoint is taken by the offsets and constraints."""
    import osqp as package
    from scipy import sparse

    matrix, offsets = sparse_program(file)
    limit = np.full(STEPS * M, float(file["u_max"]))
    none = np.zeros(STEPS * WIDTH)
    weights = none.copy()
    weights[:M] = 1
    solver = package.OSQP()
    solver.setup(sparse.eye(STEPS * WIDTH, format="csc"), none, matrix, np.r_[offsets[0], -limit],
                 np.r_[offsets[0], limit], warm_starting=False, **TIGHT)  # fmt: skip

    states = []

    def solve(differentiates):
        found = []
        for offset in offsets:
            solver.update(l=np.r_[offset, -limit], u=np.r_[offset, limit])
            result = solver.solve(raise_error=False)
            found.append(result.x)
            states.append(result.info.status)
            if differentiates:
                solver.adjoint_derivative_compute(dx=weights)
                solver.adjoint_derivative_get_mat()
        return np.array(found).reshape(len(offsets), STEPS, WIDTH)[..., :M]

    alone, controls = fastest(lambda: solve(False), 5.0, 3)
    if set(states) != {"solved"}:  # it refuses to differentiate
        return Measured(alone, controls)
    both, _ = fastest(lambda: solve(True), 5.0, 3)
    return Measured(alone, controls, both)


def parametrised(u_max):
    """One problem of cvxpy with A, B, b and the first state as parameters."""
    import cvxpy

    A, B = cvxpy.Parameter((N, N), name="A"), cvxpy.Parameter((N, M), name="B")
    b, first = cvxpy.Parameter(N, name="b"), cvxpy.Parameter(N, name="first")
    x, u = cvxpy.Variable((N, STEPS + 1), name="x"), cvxpy.Variable((M, STEPS), name="u")
    cost = 0.5 * cvxpy.sum_squares(x) + 0.5 * cvxpy.sum_squares(u)
    held = [x[:, 0] == first, u <= u_max, u >= -u_max]
    held += [x[:, t + 1] == A @ x[:, t] + B @ u[:, t] + b for t in range(STEPS)]
    return cvxpy.Problem(cvxpy.Minimize(cost), held), [A, B, b, first], u


def columns(slopes):
    """Gradients by A, B and b as the reference has them."""
    return np.concatenate([np.asarray(each).T.ravel() for each in slopes])


def cvxpylayers(file, arguments):
    """The package cvxpylayers with Clarabel inside, all problems as one batch."""
    import torch
    from cvxpylayers.torch import CvxpyLayer

    problem, parameters, u = parametrised(float(file["u_max"]))
    layer = CvxpyLayer(problem, parameters=parameters, variables=[u], solver_args=EXACT)
    leaves = [torch.tensor(file[key], requires_grad=True) for key in ("A", "B", "b")]
    start = torch.tensor(file["x0"])

    def solve():
        shared = [each.expand(len(start), *each.shape) for each in leaves]
        return layer(*shared, start)[0].movedim(1, 2)

    def differentiate():
        return torch.autograd.grad(solve()[:, 0].sum(), leaves)

    with torch.no_grad():
        alone, controls = fastest(solve, 5.0, 2)
    both, slopes = fastest(differentiate, 5.0, 2)
    return Measured(alone, controls.numpy(), both, columns(slopes))


def cvxpygen(file, arguments):
    """Code that the package cvxpygen generates around OSQP, with its gradient."""
    # explicit solutions, which nobody asks for here, would load Julia
    sys.modules.setdefault("pdaqp", types.SimpleNamespace(MPQP=None))
    from cvxpygen import cpg

    problem, (A, B, b, first), u = parametrised(float(file["u_max"]))
    A.value, B.value, b.value = file["A"], file["B"], file["b"]
    first.value = file["x0"][0]
    settings = {k: v for k, v in TIGHT.items() if k != "verbose"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        sys.path.insert(0, folder)
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            cpg.generate_code(problem, code_dir="lqr", solver="OSQP", gradient=True)
        generated = importlib.import_module("lqr.cpg_solver")
        problem.register_solve("generated", generated.cpg_solve)

        def solve(differentiates):
            found, slopes = [], [0.0, 0.0, 0.0]
            for each in file["x0"]:
                first.value = each
                problem.solve(
                    method="generated", updated_params=["first"], warm_start=False, **settings
                )
                found.append(u.value.T.copy())
                if differentiates:
                    for variable in problem.variables():
                        variable.gradient = np.zeros(variable.shape)
                    u.gradient = np.eye(STEPS)[:1].repeat(M, 0)
                    generated.cpg_gradient(problem)
                    slopes = [s + p.gradient for s, p in zip(slopes, (A, B, b), strict=True)]
            return np.array(found), slopes

        alone, (controls, _) = fastest(lambda: solve(False), 5.0, 2)
        both, (_, slopes) = fastest(lambda: solve(True), 5.0, 2)
    return Measured(alone, controls, both, columns(slopes))


SOLVERS = {"OSQP": osqp, "cvxpylayers": cvxpylayers, "cvxpygen (OSQP)": cvxpygen}
