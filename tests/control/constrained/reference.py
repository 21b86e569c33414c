"""The same drives posed to IPOPT through CasADi: states and controls as unknowns."""

import functools
from typing import NamedTuple

import casadi
import numpy as np

from tests.control.constrained.problems import BOX, DT


class Reference(NamedTuple):
    """What IPOPT found for one drive."""

    states: np.ndarray  # T+1 4
    controls: np.ndarray  # T 2
    cost: float
    solved: bool
    status: str


class Programme(NamedTuple):
    """Drives of one size in symbols, time by time."""

    states: casadi.SX  # 4 T+1
    controls: casadi.SX  # 2 T
    given: casadi.SX
    cost: casadi.SX
    start: casadi.SX  # zero at the given state
    gaps: list[casadi.SX]  # zero where a step is the dynamics'
    unequal: list[list[casadi.SX]]  # at most zero, T+1


@functools.cache
def programme(steps, discs):
    """The drives of `problems.py`."""
    x, u = casadi.SX.sym("x", 4, steps + 1), casadi.SX.sym("u", 2, steps)
    start, goal = casadi.SX.sym("start", 4), casadi.SX.sym("goal", 2)
    centre, velocity = casadi.SX.sym("c", 2, discs), casadi.SX.sym("v", 2, discs)
    radius, rest = casadi.SX.sym("r", discs), casadi.SX.sym("rest", 6)
    top_speed, grip, near, slow, effort, wheelbase = casadi.vertsplit(rest)
    cost, gaps, unequal = 0, [], []
    for t in range(steps + 1):
        cost += near * casadi.sumsqr(x[:2, t] - goal) + slow * (x[3, t] - 2) ** 2
        now = []
        if t > 0:
            now.append(x[3, t] - top_speed)
            for i in range(discs):
                away = x[:2, t] - centre[:, i] - velocity[:, i] * (DT * t)
                now.append(1 - casadi.sumsqr(away) / radius[i] ** 2)
        if t < steps:
            cost += effort * (0.2 * u[0, t] ** 2 + u[1, t] ** 2)
            rates = casadi.vertcat(
                x[3, t] * casadi.cos(x[2, t]),
                x[3, t] * casadi.sin(x[2, t]),
                x[3, t] / wheelbase * casadi.tan(u[1, t]),
                u[0, t],
            )
            gaps.append(x[:, t + 1] - x[:, t] - DT * rates)
            turning = x[3, t] ** 2 * casadi.tan(u[1, t]) / wheelbase
            now.append((u[0, t] ** 2 + turning**2) / grip**2 - 1)
        unequal.append(now)
    given = casadi.vertcat(start, goal, casadi.vec(centre), casadi.vec(velocity), radius, rest)
    return Programme(x, u, given, cost, x[:, 0] - start, gaps, unequal)


@functools.cache
def posed(steps, discs):
    """Solver of drives of one size, and its numbers of unknowns and constraints."""
    drive = programme(steps, discs)
    unequal = [each for now in drive.unequal for each in now]
    unknown = casadi.vertcat(casadi.vec(drive.states), casadi.vec(drive.controls))
    rows = casadi.vertcat(drive.start, *drive.gaps, *unequal)
    problem = {"x": unknown, "p": drive.given, "f": drive.cost, "g": rows}
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    solver = casadi.nlpsol("drive", "ipopt", problem, {**options, "ipopt.max_iter": 500})
    return solver, 4 * (steps + 1), len(unequal)


def numbers_of(drive, index):
    """The numbers of one drive of a batch, in the order of `Programme.given`, and its state."""
    part = [np.asarray(tensor[index]) for tensor in drive]
    state, goal, centre, velocity, radius, top_speed, grip, weight, wheelbase = part
    given = np.concatenate(
        [state, goal, centre.ravel(), velocity.ravel(), radius]
        + [np.atleast_1d(number) for number in (top_speed, grip, weight, wheelbase)]
    )
    return given, state


def by_ipopt(drive, index, controls, states=None):
    """Solve one drive of a batch from a guess of its controls, and of its states if given."""
    steps, discs = len(controls), drive.radius.shape[1]
    solver, count, unequal = posed(steps, discs)
    given, state = numbers_of(drive, index)
    guess = np.tile(state, (steps + 1, 1)) if states is None else states
    free = np.full(count, np.inf)
    lower, upper = (
        np.concatenate([s * free, np.tile(side, steps)])
        for s, side in zip((-1, 1), BOX, strict=True)
    )
    zero = np.zeros(4 * (steps + 1))
    found = solver(
        x0=np.concatenate([guess.ravel(), np.asarray(controls).ravel()]),
        p=given,
        lbx=lower,
        ubx=upper,
        lbg=np.concatenate([zero, np.full(unequal, -np.inf)]),
        ubg=np.concatenate([zero, np.zeros(unequal)]),
    )
    z, stats = found["x"].full().ravel(), solver.stats()
    return Reference(
        z[:count].reshape(-1, 4),
        z[count:].reshape(-1, 2),
        float(found["f"]),
        bool(stats["success"]),
        stats["return_status"],
    )
