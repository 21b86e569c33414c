"""mpc.pytorch (package `mpc`): its state carries a clock, because its cost is not told the time."""

import numpy as np
import torch
from mpc import mpc

from peers import driving


class Space:
    """Functions of torch under the names of numpy."""

    cos, sin, tan, exp = torch.cos, torch.sin, torch.tan, torch.exp
    maximum = staticmethod(torch.clamp_min)


class Dynamics(torch.nn.Module):
    """Bicycle and clock."""

    def forward(self, state, control):
        following = driving.step(Space, state[:, :4].unbind(-1), control.unbind(-1))
        return torch.stack([*following, state[:, 4] + 1], -1)


class Cost(torch.nn.Module):
    """Running cost before the last time, final cost at it."""

    def __init__(self, parameters, steps):
        super().__init__()
        self.parameters_of_all, self.steps = parameters, steps

    def forward(self, tau):
        columns, p = tau.unbind(-1), self.parameters_of_all.unbind(-1)
        running = driving.stage_cost(Space, columns[:4], columns[5:], p)
        idle = 1e-3 * (columns[5] ** 2 + columns[6] ** 2)
        last = (columns[4] > self.steps - 0.5).to(tau.dtype)
        return (1 - last) * running + last * (driving.final_cost(columns[:4], p) + idle)


def solve_all(states, parameters, steps, iterations=30):
    """Controls (count, T, 2)."""
    state, p = (torch.tensor(part, dtype=torch.float32) for part in (states, parameters))
    start = torch.cat([state, torch.zeros(len(state), 1)], -1)
    low, high = (
        torch.tensor(bound).expand(steps + 1, len(state), 2).contiguous()
        for bound in (driving.LOWER, driving.UPPER)
    )
    solver = mpc.MPC(
        5,
        2,
        steps + 1,
        u_lower=low,
        u_upper=high,
        lqr_iter=iterations,
        eps=1e-4,
        verbose=-1,
        grad_method=mpc.GradMethods.AUTO_DIFF,
        exit_unconverged=False,
        detach_unconverged=False,
        backprop=False,
        n_batch=len(state),
    )
    with torch.enable_grad():
        controls = solver(start, Cost(p, steps), Dynamics())[1]
    return controls[:steps].transpose(0, 1).detach().double().numpy().astype(np.float64)


def prepare(states, parameters, steps):
    """A function that returns the controls (count, T, 2)."""
    return lambda: solve_all(states, parameters, steps)
