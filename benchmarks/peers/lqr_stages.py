"""Peers that know the stages on the bounded LQRs: crocoddyl's own LQR in C++, and fatrop. H is the identity to them."""

import numpy as np

from peers.problem import Problem
from peers.times import STEPS, M, Measured, N, fastest


def crocoddyl(file, arguments):
    """BoxFDDP on ActionModelLQR, one thread; it stops where the squares of its slopes sum up to 1e-14."""
    import crocoddyl as package

    limit = np.full(M, float(file["u_max"]))
    none = np.zeros((N, M)), file["b"], np.zeros(N), np.zeros(M)
    model = package.ActionModelLQR(file["A"], file["B"], np.eye(N), np.eye(M), *none)
    model.u_lb, model.u_ub = -limit, limit
    shooting = package.ShootingProblem(file["x0"][0], [model] * STEPS, model)
    shooting.nthreads = 1
    solver = package.SolverBoxFDDP(shooting)
    solver.th_stop = 1e-14

    def solve_one(state):
        shooting.x0 = state
        solver.solve([state] * (STEPS + 1), [np.zeros(M)] * STEPS, 500, False)
        return np.stack(solver.us)

    alone, controls = fastest(lambda: np.stack([solve_one(state) for state in file["x0"]]), 10.0, 3)
    return Measured(alone, controls)


def fatrop(file, arguments):
    """Fatrop through CasADi, to 1e-10."""
    from peers import fatrop as package

    A, B, b = (file[key] for key in ("A", "B", "b"))

    class Linear(Problem):
        states, numbers = N, 0

        def step(self, xp, state, control, physical=None):
            moved = [sum(a * x for a, x in zip(row, state, strict=True)) for row in A]
            pushed = [sum(a * u for a, u in zip(row, control, strict=True)) for row in B]
            return tuple(x + u + c for x, u, c in zip(moved, pushed, b, strict=True))

        def stage_cost(self, xp, state, control, p):
            return 0.5 * sum(each**2 for each in [*state, *control])

        def final_cost(self, xp, state, p):
            return 0.5 * sum(each**2 for each in state)

    limit = (float(file["u_max"]),) * M
    problem = Linear(tuple(-each for each in limit), limit)
    given = file["x0"], np.zeros((len(file["x0"]), 0)), STEPS, problem
    nlp = package.build(STEPS, problem, tolerance=1e-10)
    alone, controls = fastest(lambda: package.solve_all(nlp, *given), 10.0, 3)
    return Measured(alone, controls)


SOLVERS = {"crocoddyl (BoxFDDP, its own LQR)": crocoddyl, "fatrop (CasADi)": fatrop}
