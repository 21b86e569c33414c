"""What the solvers written in torch share."""

import torch

from peers import driving


class Space:
    """Functions of torch under the names of numpy."""

    cos, sin, tan, exp = torch.cos, torch.sin, torch.tan, torch.exp
    maximum = staticmethod(torch.clamp_min)


def quadratic_form(goal, steps):
    """The free variant as 1/2 z'Qz + q'z of z = (state, control): Q (T + 1, B, 6, 6), q (T + 1, B, 6)."""
    twice = 2 * torch.tensor(driving.squares(steps), dtype=goal.dtype)[:, None]
    wanted = torch.cat([goal, goal.new_zeros(len(goal), 2)], -1)
    return torch.diag_embed(twice).expand(-1, len(goal), -1, -1), -twice * wanted


def loss(states, controls):
    """What the gradients are of: a number that depends on the whole solution."""
    return controls.square().sum() + states.sum()


def recorder(solve, parameters):
    """A function that solves and returns a function that returns the gradient (count, 4) to the goal.

    solve maps goals (count, 4) to states and controls.
    """

    def record():
        goal = torch.tensor(parameters[:, :4], dtype=torch.float32, requires_grad=True)
        outcome = loss(*solve(goal))
        return lambda: torch.autograd.grad(outcome, goal)[0].numpy()

    return record
