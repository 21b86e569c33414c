"""Fatrop (inside of CasADi): an interior-point method that knows the stages, one problem after the other.

Unknowns and constraints come stage by stage, as it wants them: state and control, then the gap to the next state.
"""

import casadi
import numpy as np

from peers.ipopt import Space


def build(steps, problem, tolerance=1e-4):
    """The nonlinear programme in the order of the stages; what varies is its parameter."""
    n, m = problem.states, len(problem.lower)
    X = [casadi.SX.sym(f"x{t}", n) for t in range(steps + 1)]
    U = [casadi.SX.sym(f"u{t}", m) for t in range(steps)]
    given = casadi.SX.sym("given", n + problem.numbers)
    p, total, rows = [given[n + i] for i in range(problem.numbers)], 0, []
    states = [[x[i] for i in range(n)] for x in X]
    for t in range(steps):
        control = [U[t][i] for i in range(m)]
        total += problem.stage_cost(Space, states[t], control, p)
        rows.append(X[t + 1] - casadi.vertcat(*problem.step(Space, states[t], control)))
        if t == 0:
            rows.append(X[0] - given[:n])
    total += problem.final_cost(Space, states[steps], p)
    stages = [part for t in range(steps) for part in (X[t], U[t])]
    rows = casadi.vertcat(*rows)
    programme = {"x": casadi.vertcat(*stages, X[steps]), "f": total, "g": rows, "p": given}
    options = {
        "print_time": False,
        "fatrop": {"print_level": 0, "tol": tolerance},
        "structure_detection": "manual",
        "equality": [True] * rows.numel(),
        "N": steps,
        "nx": [n] * (steps + 1),
        "nu": [m] * steps + [0],
        "ng": [n] + [0] * steps,  # the first state is given
    }
    return casadi.nlpsol("solver", "fatrop", programme, options)


def solve_all(nlp, states, parameters, steps, problem):
    """Controls (count, T, m)."""
    n, m = problem.states, len(problem.lower)
    free = np.full(n, np.inf)
    low = np.concatenate([np.tile(np.concatenate([-free, problem.lower]), steps), -free])
    high = np.concatenate([np.tile(np.concatenate([free, problem.upper]), steps), free])
    answers = []
    for state, p in zip(states, parameters, strict=True):
        start = np.zeros((steps + 1, n + m))
        start[:, :n] = problem.idle(state, steps)
        given = np.concatenate([state, p])
        result = nlp(x0=start.ravel()[:-m], p=given, lbx=low, ubx=high, lbg=0, ubg=0)
        stages = np.array(result["x"]).ravel()[: (n + m) * steps].reshape(steps, n + m)
        answers.append(stages[:, n:])
    return np.stack(answers)


def prepare(states, parameters, steps, problem):
    """A function that returns the controls (count, T, m)."""
    nlp = build(steps, problem)
    return lambda: solve_all(nlp, states, parameters, steps, problem)
