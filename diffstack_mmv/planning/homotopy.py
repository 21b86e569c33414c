"""Homotopy classes: on which side of each agent a plan passes."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

LATER = 1e5
"""Added to the price of plans of classes already seen; small enough for single precision."""
NEAR_M = 2.0
"""An agent further away than this at the closest approach does not tell classes apart."""


def homotopy_class(
    position: Float[Tensor, "*b C T1 2"], agents: Float[Tensor, "*b N T1 2"]
) -> Int[Tensor, "*b C"]:
    """Class of each plan: equal for plans that pass the same agents on the same sides.

    At the closest approach the agent lies left or right of the relative motion; each agent adds a
    ternary digit (far, left, right).

    Args:
        position: Positions of the plans in m.
        agents: Positions of the agents in m at the same times.

    Returns:
        A number per plan, modulo 2⁶³, in no particular order.
    """
    relative = agents.unsqueeze(-4) - position.unsqueeze(-3)
    squared = relative.square().sum(-1)
    nearest = squared[..., :-1].argmin(-1, keepdim=True)
    velocity = relative.diff(dim=-2).take_along_dim(nearest.unsqueeze(-1), -2).squeeze(-2)
    offset = relative.take_along_dim(nearest.unsqueeze(-1), -2).squeeze(-2)
    cross = velocity[..., 0] * offset[..., 1] - velocity[..., 1] * offset[..., 0]
    near = squared.amin(-1) < NEAR_M**2
    digit = torch.where(near, 1 + (cross > 0).long(), 0)
    weight = 3 ** (torch.arange(digit.shape[-1], device=digit.device) % 39)
    return (digit * weight).sum(-1)


def best_of_each(
    price: Float[Tensor, "*b C"], classes: Int[Tensor, "*b C"], count: int
) -> Int[Tensor, "*b k"]:
    """Cheapest plan of each of the `count` cheapest classes, cheapest first.

    Where there are fewer classes, the cheapest remaining plans of any of them follow.

    Args:
        price: Price of each plan.
        classes: Homotopy class of each plan.
        count: How many to choose, at most the number of plans.

    Returns:
        Indices of different plans.
    """
    taken = torch.zeros_like(price, dtype=torch.bool)
    seen = torch.zeros_like(taken)
    chosen = []
    for _ in range(count):
        # plans of classes already seen come after all others, plans already taken never
        order = torch.where(seen, price + LATER, price).masked_fill(taken, torch.inf)
        index = order.argmin(-1, keepdim=True)
        chosen.append(index)
        taken = taken.scatter(-1, index, True)
        seen = seen | (classes == classes.take_along_dim(index, -1))
    return torch.cat(chosen, -1)
