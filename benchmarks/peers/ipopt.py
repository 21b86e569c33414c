"""CasADi with IPOPT: multiple shooting, one problem after the other, from zero controls."""

import casadi
import numpy as np

from peers import driving


class Space:
    """Functions of CasADi under the names of numpy."""

    cos, sin, tan, exp, maximum = casadi.cos, casadi.sin, casadi.tan, casadi.exp, casadi.fmax


def build(steps, variant=driving.OBSTACLE, plugin="ipopt"):
    """The nonlinear programme over controls and states; what varies is its parameter."""
    U, X = casadi.SX.sym("U", 2, steps), casadi.SX.sym("X", 4, steps)
    given = casadi.SX.sym("given", 11)
    p = [given[4 + i] for i in range(7)]
    state, total, gaps = [given[i] for i in range(4)], 0, []
    for t in range(steps):
        control = [U[0, t], U[1, t]]
        total += driving.stage_cost(Space, state, control, p, variant)
        gaps.append(casadi.vertcat(*driving.step(Space, state, control)) - X[:, t])
        state = [X[i, t] for i in range(4)]
    total += driving.final_cost(state, p)
    z = casadi.vertcat(casadi.vec(U), casadi.vec(X))
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "tol": 1e-4, "sb": "yes"}}
    problem = {"x": z, "f": total, "g": casadi.vertcat(*gaps), "p": given}
    return casadi.nlpsol("solver", plugin, problem, quiet)


def solve_all(nlp, states, parameters, steps, variant):
    """Controls (count, T, 2)."""
    low = np.concatenate([np.tile(variant.lower, steps), np.full(4 * steps, -np.inf)])
    high = np.concatenate([np.tile(variant.upper, steps), np.full(4 * steps, np.inf)])
    answers = []
    for state, p in zip(states, parameters, strict=True):
        current, path = tuple(state), []
        for _ in range(steps):
            current = driving.step(np, current, (0.0, 0.0))
            path.extend(current)
        start = np.concatenate([np.zeros(2 * steps), path])
        result = nlp(x0=start, p=np.concatenate([state, p]), lbx=low, ubx=high, lbg=0, ubg=0)
        answers.append(np.array(result["x"]).ravel()[: 2 * steps].reshape(steps, 2))
    return np.stack(answers)


def prepare(states, parameters, steps, variant):
    """A function that returns the controls (count, T, 2)."""
    nlp = build(steps, variant)
    return lambda: solve_all(nlp, states, parameters, steps, variant)
