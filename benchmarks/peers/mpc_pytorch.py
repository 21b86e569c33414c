"""mpc.pytorch (package `mpc`).

With the bump its state carries a clock, because its general cost is not told the time; the free
variant is a quadratic cost that it takes as matrices.
"""

import numpy as np
import torch
from mpc import mpc

from peers import driving
from peers.in_torch import Space, quadratic_form, recorder


class Dynamics(torch.nn.Module):
    """Bicycle."""

    def forward(self, state, control):
        return torch.stack(driving.step(Space, state.unbind(-1), control.unbind(-1)), -1)


class ClockedDynamics(torch.nn.Module):
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


def solver(width, length, count, **settings):
    """The settings of all variants."""
    return mpc.MPC(
        width,
        2,
        length,
        lqr_iter=30,
        eps=1e-4,
        verbose=-1,
        grad_method=mpc.GradMethods.AUTO_DIFF,
        exit_unconverged=False,
        detach_unconverged=False,
        n_batch=count,
        **settings,
    )


def solve_with_clock(states, parameters, steps, variant):
    """Controls (T + 1, count, 2)."""
    state, p = (torch.tensor(part, dtype=torch.float32) for part in (states, parameters))
    start = torch.cat([state, torch.zeros(len(state), 1)], -1)
    low, high = (
        torch.tensor(bound).expand(steps + 1, len(state), 2).contiguous()
        for bound in (variant.lower, variant.upper)
    )
    solve = solver(5, steps + 1, len(state), u_lower=low, u_upper=high, backprop=False)
    return solve(start, Cost(p, steps), ClockedDynamics())[1]


def solve_free(states, steps):
    """A function from goals (count, 4) to states (T + 1, count, 4) and controls (T, count, 2)."""
    state = torch.tensor(states, dtype=torch.float32)
    solve = solver(4, steps + 1, len(state))

    def solution(goal):
        form = mpc.QuadCost(*quadratic_form(goal, steps))
        path, controls, _ = solve(state, form, Dynamics())
        return path, controls[:steps]

    return solution


def prepare(states, parameters, steps, variant):
    """A function that returns the controls (count, T, 2)."""
    goal = torch.tensor(parameters[:, :4], dtype=torch.float32)

    def solve():
        with torch.enable_grad():
            controls = (
                solve_with_clock(states, parameters, steps, variant)
                if variant.bump
                else solve_free(states, steps)(goal)[1]
            )
        return controls[:steps].transpose(0, 1).detach().double().numpy().astype(np.float64)

    return solve


def prepare_gradient(states, parameters, steps, problem):
    """See `recorder`; of the free variant."""
    return recorder(solve_free(states, steps), parameters)
