"""Crocoddyl's own example: a unicycle that returns to the origin, with and without bounds of its controls.

State (x, y, heading), control (speed, turn rate), Euler steps of 0.1 s; every state costs half its square times
100, every control half its square. Crocoddyl has it in C++ (ActionModelUnicycle).
"""

from dataclasses import dataclass

import numpy as np

from peers.problem import Problem

DT, STATE_WEIGHT, CONTROL_WEIGHT = 0.1, 10.0, 1.0  # the weights are squared


@dataclass(frozen=True)
class Unicycle(Problem):
    """The goal is a parameter, and at the origin."""

    states, numbers, physical = 3, 3, DT
    penalty = 1e5

    def step(self, xp, state, control, physical=DT):
        x, y, heading = state
        moved = physical * control[0]
        turned = heading + physical * control[1]
        return x + moved * xp.cos(heading), y + moved * xp.sin(heading), turned

    def stage_cost(self, xp, state, control, p):
        effort = 0.5 * CONTROL_WEIGHT**2 * (control[0] ** 2 + control[1] ** 2)
        return self.final_cost(xp, state, p) + effort

    def final_cost(self, xp, state, p):
        squares = [(each - p[i]) ** 2 for i, each in enumerate(state)]
        return 0.5 * STATE_WEIGHT**2 * (squares[0] + squares[1] + squares[2])

    def instances(self, count, steps):
        rng = np.random.default_rng([2024, 3])
        states = np.column_stack(
            [rng.uniform(-1, 1, (count, 2)), rng.uniform(-np.pi, np.pi, count)]
        )
        return states, np.zeros((count, 3))


BOXED = Unicycle((-1.0, -1.0), (1.0, 1.0))
FREE = Unicycle((-np.inf, -np.inf), (np.inf, np.inf))
