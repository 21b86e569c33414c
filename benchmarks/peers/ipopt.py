"""CasADi with IPOPT: multiple shooting, one problem after the other, from zero controls."""

import casadi
import numpy as np


class Space:
    """Functions of CasADi under the names of numpy."""

    cos, sin, tan, exp, maximum = casadi.cos, casadi.sin, casadi.tan, casadi.exp, casadi.fmax


def build(steps, problem):
    """The nonlinear programme over controls and states; what varies is its parameter."""
    n, m = problem.states, len(problem.lower)
    U, X = casadi.SX.sym("U", m, steps), casadi.SX.sym("X", n, steps)
    given = casadi.SX.sym("given", n + problem.numbers)
    p = [given[n + i] for i in range(problem.numbers)]
    state, total, gaps = [given[i] for i in range(n)], 0, []
    for t in range(steps):
        control = [U[i, t] for i in range(m)]
        total += problem.stage_cost(Space, state, control, p)
        gaps.append(casadi.vertcat(*problem.step(Space, state, control)) - X[:, t])
        state = [X[i, t] for i in range(n)]
    total += problem.final_cost(Space, state, p)
    z = casadi.vertcat(casadi.vec(U), casadi.vec(X))
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "tol": 1e-4, "sb": "yes"}}
    programme = {"x": z, "f": total, "g": casadi.vertcat(*gaps), "p": given}
    return casadi.nlpsol("solver", "ipopt", programme, quiet)


def solve_all(nlp, states, parameters, steps, problem):
    """Controls (count, T, m)."""
    n, m = problem.states, len(problem.lower)
    free = np.full(n * steps, np.inf)
    low = np.concatenate([np.tile(problem.lower, steps), -free])
    high = np.concatenate([np.tile(problem.upper, steps), free])
    answers = []
    for state, p in zip(states, parameters, strict=True):
        start = np.concatenate([np.zeros(m * steps), problem.idle(state, steps)[1:].ravel()])
        result = nlp(x0=start, p=np.concatenate([state, p]), lbx=low, ubx=high, lbg=0, ubg=0)
        answers.append(np.array(result["x"]).ravel()[: m * steps].reshape(steps, m))
    return np.stack(answers)


def prepare(states, parameters, steps, problem):
    """A function that returns the controls (count, T, m)."""
    nlp = build(steps, problem)
    return lambda: solve_all(nlp, states, parameters, steps, problem)
