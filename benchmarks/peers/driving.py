"""The problem of all solvers: a kinematic bicycle that drives to a goal around an obstacle.

State (x, y, heading, speed), control (acceleration, steer), 0.1 s steps, box bounds; goal, heading,
speed, effort and one Gaussian bump, which makes it non-convex. Every formula is written once, on
components and any array namespace. A free variant without bump and box is what solvers of quadratic
costs and of problems without bounds can express, too.
"""

from dataclasses import dataclass

import numpy as np

from peers.problem import Problem

DT, WHEELBASE = 0.1, 1.05
WEIGHTS = (0.005, 0.05, 0.20, 0.02, 0.10, 2.0, 0.5)
LOWER, UPPER = (-5.0, -0.785), (4.0, 0.785)


@dataclass(frozen=True)
class Driving(Problem):
    """Weights of acceleration and steer, and of the bump."""

    effort: tuple[float, float] = WEIGHTS[3:5]
    bump: float = WEIGHTS[5]

    physical = WHEELBASE

    @property
    def differentiated(self):
        """Without the bump, which few peers that differentiate can express."""
        return not self.bump

    def step(self, xp, state, control, physical=WHEELBASE):
        return step(xp, state, control, physical)

    def stage_cost(self, xp, state, control, p):
        return stage_cost(xp, state, control, p, self)

    def final_cost(self, xp, state, p):
        return final_cost(state, p)

    def instances(self, count, steps):
        return instances(count, steps)


OBSTACLE = Driving(LOWER, UPPER)
FREE = Driving((-np.inf, -np.inf), (np.inf, np.inf), (0.1, 2.0), 0.0)


def step(xp, state, control, wheelbase=WHEELBASE):
    """One Euler step; the speed stays at zero or above."""
    x, y, heading, speed = state
    acceleration, steer = control
    after = xp.maximum(speed + DT * acceleration, 0)
    return (
        x + DT * speed * xp.cos(heading),
        y + DT * speed * xp.sin(heading),
        heading + DT * after / wheelbase * xp.tan(steer),
        after,
    )


def stage_cost(xp, state, control, p, variant=OBSTACLE):
    """Running cost; p = goal x, y, heading, speed, and with a bump obstacle x, y, radius."""
    x, y, heading, speed = state
    smooth = (
        WEIGHTS[0] * ((x - p[0]) ** 2 + (y - p[1]) ** 2)
        + WEIGHTS[1] * (heading - p[2]) ** 2
        + WEIGHTS[2] * (speed - p[3]) ** 2
        + variant.effort[0] * control[0] ** 2
        + variant.effort[1] * control[1] ** 2
    )
    if not variant.bump:
        return smooth
    away = (x - p[4]) ** 2 + (y - p[5]) ** 2
    return smooth + variant.bump * xp.exp(-0.5 * away / p[6] ** 2)


def final_cost(state, p):
    """Squared distance of the last position to the goal."""
    return WEIGHTS[6] * ((state[0] - p[0]) ** 2 + (state[1] - p[1]) ** 2)


def squares(steps):
    """Weights (T + 1, 6) of the squared differences of state and control from (goal, 0), free.

    A control after the end, which some solvers have, keeps its weight: its optimum is zero.
    """
    running = [WEIGHTS[0], *WEIGHTS[:3], *FREE.effort]
    return np.array([running] * steps + [[WEIGHTS[6], WEIGHTS[6], 0, 0, *FREE.effort]])


def instances(count, steps, seed=2024):
    """Random states (count, 4) and parameters (count, 7); goals within reach of the horizon."""
    rng = np.random.default_rng([seed, 2])
    speed, heading = rng.uniform(1, 6, count), rng.uniform(-np.pi, np.pi, count)
    position = rng.uniform(-1, 1, (count, 2))
    distance = rng.uniform(3, 15, count) * steps / 30
    bearing = heading + rng.uniform(-1, 1, count)
    ahead = np.stack([np.cos(bearing), np.sin(bearing)], 1)
    goal = position + distance[:, None] * ahead
    side = rng.uniform(0.05, 0.8, count) * rng.choice([-1, 1], count)
    between = rng.uniform(0.3, 0.7, count) * distance
    left = np.stack([-ahead[:, 1], ahead[:, 0]], 1)
    obstacle = position + between[:, None] * ahead + side[:, None] * left
    wanted = np.clip(distance / (DT * steps), 0.8, 5)
    radius = rng.uniform(0.5, 1, count)
    states = np.column_stack([position, heading, speed])
    return states, np.column_stack([goal, bearing, wanted, obstacle, radius])
