"""PyPose: its linear-quadratic step for nonlinear systems, iterated here for a batch.

The loop of its MPC module compares the cost of one problem and its Jacobians are of one problem, so
both are done here for all of a batch: the best iterate of each problem is kept and the last step
carries the gradient, as its MPC does. It has no line search, and takes but does not use bounds.
"""

import numpy as np
import torch
from pypose.module import LQR, NLS
from pypose.utils import ReduceToBason

from peers import driving
from peers.in_torch import Space, quadratic_form, recorder


class Bicycle(NLS):
    """The step, with Jacobians of a batch."""

    def state_transition(self, state, input, t=None):
        return torch.stack(driving.step(Space, state.unbind(-1), input.unbind(-1)), -1)

    def observation(self, state, input, t=None):
        return state

    def jacobian(self, argument):
        """Derivative (B, 4, .) of the step to the state or the control, at the reference point."""
        of_one = torch.func.jacrev(self.state_transition, argument)
        return torch.func.vmap(of_one)(self._ref_state, self._ref_input)

    @property
    def A(self):  # noqa: N802
        return self.jacobian(0)

    @property
    def B(self):  # noqa: N802
        return self.jacobian(1)


def solve_free(states, steps):
    """A function from goals (count, 4) to states (count, T + 1, 4) and controls (count, T, 2)."""
    state = torch.tensor(states, dtype=torch.float32)

    def solution(goal):
        weights, slopes = (part.transpose(0, 1) for part in quadratic_form(goal, steps))
        controls = state.new_zeros(len(state), steps + 1, 2)
        lowest, best = state.new_full((len(state),), torch.inf), controls
        with torch.no_grad():
            lqr = LQR(Bicycle(), weights.detach(), slopes.detach(), steps + 1)
            stepper = ReduceToBason(50, decreasing=1e-4)
            while stepper.continual():
                _, controls, cost = lqr(state, u_traj=controls)
                stepper.step(cost)
                better = cost < lowest
                best = torch.where(better[:, None, None], controls, best)
                lowest = torch.where(better, cost, lowest)
        path, controls, _ = LQR(Bicycle(), weights, slopes, steps + 1)(state, u_traj=best)
        return path[:, : steps + 1], controls[:, :steps]

    return solution


def prepare(states, parameters, steps, variant):
    """A function that returns the controls (count, T, 2)."""
    goal = torch.tensor(parameters[:, :4], dtype=torch.float32)
    solve_all = solve_free(states, steps)

    def solve():
        with torch.no_grad():
            return solve_all(goal)[1].double().numpy().astype(np.float64)

    return solve


def prepare_gradient(states, parameters, steps, problem):
    """See `recorder`."""
    return recorder(solve_free(states, steps), parameters)
