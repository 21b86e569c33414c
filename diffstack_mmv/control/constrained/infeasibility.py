"""Tells a problem that cannot meet its constraints from one that is not there yet."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.constrained.condensed import sensitivity_of_rows
from diffstack_mmv.control.constrained.local import Problem, linearise_rows
from diffstack_mmv.control.expansion import linearise_dynamics, pad_controls

TRAPPED = 1e-3
"""Gradient of the violation, relative to that of its rows without regard to their signs."""


def is_trapped(problem: Problem, u: Float[Tensor, "*b T m"]) -> Bool[Tensor, "*b"]:
    """Where the controls are stationary for the squared violation of the hard rows in the box."""
    rows, leading = problem.rows, problem.state.shape[:-1]
    x, acting = problem.rollout(u), pad_controls(u)
    jacobians = linearise_dynamics(problem.dynamics, x[..., :-1, :], u)
    of_x, of_u = linearise_rows(rows, x, acting)
    flat = [
        part.reshape(-1, *part.shape[len(leading) :])
        for part in (*jacobians, of_x, of_u[..., :-1, :, :])
    ]
    J = sensitivity_of_rows(*flat)
    values = rows.values(x, acting)
    excess = torch.where(rows.signed, values, values.clamp_min(0))
    excess = torch.where(rows.linear.isinf() & rows.applies, excess, torch.zeros_like(excess))
    pulls = J * excess.reshape(len(J), -1, 1)
    gradient = pulls.sum(1)
    lower, upper = problem.bounds
    held = ((u <= lower) & (gradient.view_as(u) > 0)) | ((u >= upper) & (gradient.view_as(u) < 0))
    left = torch.where(held.reshape(gradient.shape), torch.zeros_like(gradient), gradient)
    return (left.norm(dim=1) <= TRAPPED * pulls.abs().sum(1).norm(dim=1)).view(leading)
