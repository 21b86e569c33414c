"""Fatrop (inside of CasADi) on the constrained drives: unknowns and constraints stage by stage.

To 1e-6: at 1e-8 its line search ends in rounding in three of four drives, with the same costs.
"""

import functools

import casadi
import numpy as np

from tests.control.constrained.problems import BOX
from tests.control.constrained.reference import Reference, numbers_of, programme


@functools.cache
def posed(steps, discs):
    """The solver, and the upper and lower bounds of its constraints."""
    drive = programme(steps, discs)
    stages, rows, lower, counts = [], [], [], []
    for t in range(steps + 1):
        own = [drive.start] if t == 0 else []
        counts.append(4 * len(own) + len(drive.unequal[t]))
        equal = [drive.gaps[t], *own] if t < steps else own
        rows += [*equal, *drive.unequal[t]]
        lower += [0.0] * (4 * len(equal)) + [-np.inf] * len(drive.unequal[t])
        stages.append(drive.states[:, t])
        stages += [drive.controls[:, t]] if t < steps else []
    options = {
        "print_time": False,
        "fatrop": {"print_level": 0, "tol": 1e-6, "max_iter": 500},
        "structure_detection": "manual",
        "equality": [each == 0.0 for each in lower],
        "N": steps,
        "nx": [4] * (steps + 1),
        "nu": [2] * steps + [0],
        "ng": counts,
    }
    unknown, rows = casadi.vertcat(*stages), casadi.vertcat(*rows)
    problem = {"x": unknown, "p": drive.given, "f": drive.cost, "g": rows}
    return casadi.nlpsol("drive", "fatrop", problem, options), np.array(lower)


def by_fatrop(drive, index, controls, states):
    """Solve one drive of a batch from a guess of its controls and states."""
    steps, discs = len(controls), drive.radius.shape[1]
    solver, lower = posed(steps, discs)
    free = np.full(4, np.inf)
    sides = [
        np.concatenate([np.tile(np.concatenate([sign * free, side]), steps), sign * free])
        for sign, side in zip((-1, 1), BOX, strict=True)
    ]
    guess = np.concatenate([np.column_stack([states[:-1], controls]).ravel(), states[-1]])
    given = numbers_of(drive, index)[0]
    found = solver(
        x0=guess, p=given, lbx=sides[0], ubx=sides[1], lbg=lower, ubg=np.zeros(len(lower))
    )
    z, stats = found["x"].full().ravel(), solver.stats()
    path = z[: 6 * steps].reshape(steps, 6)
    states = np.vstack([path[:, :4], z[-4:]])
    cost, told = float(found["f"]), stats["return_status"]
    return Reference(states, path[:, 4:], cost, bool(stats["success"]), str(told))
