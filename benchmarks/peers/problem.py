"""What every problem of the comparison tells a solver, and the cost that all are judged by."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Problem:
    """A trajectory optimisation problem; components of states and controls come one by one.

    Args:
        lower: Lower bound of each control, minus infinity without one.
        upper: Upper bound of each control.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    states = 4  # entries of a state
    numbers = 7  # entries of the parameters of one problem
    physical = 0.0  # the number of the dynamics that ours is differentiated by
    penalty = 100.0  # of a unit outside of the box, of solvers that know none
    differentiated = False  # whether gradients to the parameters are compared

    @property
    def bounded(self):
        """Whether a control has bounds."""
        return bool(np.isfinite(self.upper).any())

    def step(self, xp, state, control, physical=None):
        """The next state."""
        raise NotImplementedError

    def stage_cost(self, xp, state, control, p):
        """Running cost."""
        raise NotImplementedError

    def final_cost(self, xp, state, p):
        """Cost of the last state."""
        raise NotImplementedError

    def instances(self, count, steps):
        """Random states (count, states) and parameters (count, numbers)."""
        raise NotImplementedError

    def idle(self, state, steps):
        """States (T + 1, states) of zero controls: the guess of solvers that want one."""
        path = [tuple(state)]
        for _ in range(steps):
            path.append(self.step(np, path[-1], (0.0,) * len(self.lower)))
        return np.array(path)

    def true_cost(self, states, parameters, controls):
        """Cost (count,) of controls (count, T, m) in float64, clipped to the box first."""
        controls = np.clip(np.asarray(controls, float), self.lower, self.upper)
        state, p, total = tuple(states.T), parameters.T, 0.0
        for control in controls.transpose(1, 2, 0):
            total = total + self.stage_cost(np, state, control, p)
            state = self.step(np, state, control)
        return total + self.final_cost(np, state, p)
