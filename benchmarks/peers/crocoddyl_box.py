"""Crocoddyl's BoxFDDP (C++) with the model called back in Python, one problem after the other."""

import casadi
import crocoddyl
import numpy as np

from peers import driving
from peers.ipopt import Space


def compiled_functions():
    """Values and derivatives of step and costs, as functions of (state, control, parameters)."""
    x, u, p = casadi.SX.sym("x", 4), casadi.SX.sym("u", 2), casadi.SX.sym("p", 7)
    columns = [[part[i] for i in range(part.shape[0])] for part in (x, u, p)]
    following = casadi.vertcat(*driving.step(Space, *columns[:2]))
    running = driving.stage_cost(Space, *columns)
    final = driving.final_cost(columns[0], columns[2])
    z = casadi.vertcat(x, u)

    def of(cost):
        curvature, slope = casadi.hessian(cost, z)
        value = casadi.Function("value", [x, u, p], [following, cost])
        jacobian = casadi.jacobian(following, z)
        return value, casadi.Function("derivatives", [x, u, p], [jacobian, slope, curvature])

    return of(running), of(final)


class Stage(crocoddyl.ActionModelAbstract):
    """One time step, or the end."""

    def __init__(self, functions):
        super().__init__(crocoddyl.StateVector(4), 2, 0)
        self.value, self.derivatives = functions
        self.p = np.zeros(7)
        self.u_lb, self.u_ub = np.array(driving.LOWER), np.array(driving.UPPER)

    def calc(self, data, x, u=None):
        following, cost = self.value(x, np.zeros(2) if u is None else u, self.p)
        data.xnext[:], data.cost = np.ravel(following), float(cost)

    def calcDiff(self, data, x, u=None):  # noqa: N802
        jacobian, slope, curvature = (
            np.array(part) for part in self.derivatives(x, np.zeros(2) if u is None else u, self.p)
        )
        data.Fx[:], data.Fu[:] = jacobian[:, :4], jacobian[:, 4:]
        data.Lx[:], data.Lu[:] = slope[:4, 0], slope[4:, 0]
        data.Lxx[:], data.Lxu[:] = curvature[:4, :4], curvature[:4, 4:]
        data.Luu[:] = curvature[4:, 4:]


def prepare(states, parameters, steps, problem):
    """A function that returns the controls (count, T, 2), from zero controls; with obstacle and box."""
    running, final = compiled_functions()
    stages = [Stage(running), Stage(final)]
    shooting = crocoddyl.ShootingProblem(states[0], stages[:1] * steps, stages[1])
    shooting.nthreads = 1
    solver = crocoddyl.SolverBoxFDDP(shooting)
    solver.th_stop = 1e-6
    start = [np.zeros(2)] * steps

    def solve_one(state, p):
        shooting.x0, stages[0].p, stages[1].p = state, p, p
        solver.solve(shooting.rollout(start), start, 100, True)
        return np.stack(solver.us)

    def solve():
        return np.stack([solve_one(*pair) for pair in zip(states, parameters, strict=True)])

    return solve
