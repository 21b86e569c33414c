"""Crocoddyl with its own unicycle: model, derivatives and solver in C++, one problem after the other.

BoxFDDP where there are bounds, FDDP otherwise, on one thread: with two it waits longer than it computes. It stops where
the squares of its slopes sum up to 1e-4, the loosest of 1e-6 to 1 that costs no quality. The problem is built once and
given another first state.
"""

import crocoddyl
import numpy as np

from peers import unicycle


def prepare(states, parameters, steps, problem):
    """A function that returns the controls (count, T, 2), from zero controls; the goal is the origin."""
    if parameters.any():
        raise ValueError("The goal of this model is the origin.")
    model = crocoddyl.ActionModelUnicycle()
    model.dt = unicycle.DT
    model.costWeights = np.array([unicycle.STATE_WEIGHT, unicycle.CONTROL_WEIGHT])
    if problem.bounded:
        model.u_lb, model.u_ub = np.array(problem.lower), np.array(problem.upper)
    shooting = crocoddyl.ShootingProblem(states[0], [model] * steps, model)
    shooting.nthreads = 1
    solver = (crocoddyl.SolverBoxFDDP if problem.bounded else crocoddyl.SolverFDDP)(shooting)
    solver.th_stop = 1e-4
    idle = [np.zeros(2)] * steps

    def solve_one(state):
        shooting.x0 = state
        solver.solve([state] * (steps + 1), idle, 100, True)  # nothing moves without control
        return np.stack(solver.us)

    return lambda: np.stack([solve_one(state) for state in states])
