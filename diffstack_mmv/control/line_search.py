"""Rolls out a feedback policy at all step sizes at once and keeps the best of each problem."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.batch_last import apply, from_batch_last, to_batch_last, unpack, walk
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.optimizer import Cost, Dynamics


class Trajectories(NamedTuple):
    """One trajectory per problem and its cost."""

    x: Float[Tensor, "T1 n N"]
    u: Float[Tensor, "T m N"]
    cost: Float[Tensor, " N"]
    size: Float[Tensor, " N"]  # the step size α that led here


def search(
    dynamics: Dynamics,
    cost: Cost,
    like: Float[Tensor, "*b"],
    x: Float[Tensor, "T1 n N"],
    u: Float[Tensor, "T m N"],
    gains: Float[Tensor, "T m+m*n N"],
    bounds: Float[Tensor, "2 m"],
    sizes: Float[Tensor, " S"],
    noise: Float[Tensor, " N"],
) -> Trajectories:
    """Roll out u_t = clip(ū_t + α k_t + K_t (x_t - x̄_t)) from x̄_0 for every α; keep the cheapest.

    Of step sizes whose costs differ by no more than `noise`, which the precision cannot tell apart,
    the longest is taken: near the solution the model knows more than the cost. A cost that is not a
    number counts as infinite.
    """
    n, m, S = x.shape[1], u.shape[1], sizes.shape[0]
    box = bounds.reshape(2, m, 1, 1)

    def one_step(state: Tensor, control: Tensor) -> Tensor:
        following = dynamics(from_batch_last(state, like), from_batch_last(control, like))
        return to_batch_last(following, like)

    def step(state: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        old_x, old_u, k, K = unpack(row, (n, 1), (m, 1), (m, 1), (m, n, 1))
        control = old_u + sizes.unsqueeze(-1) * k + apply(K, state - old_x)
        control = torch.minimum(torch.maximum(control, box[0]), box[1])
        following = torch.vmap(one_step, (1, 1), 1)(state, control)
        return following, torch.concatenate([control, following])

    def total(states: Tensor, controls: Tensor) -> Tensor:
        padded = pad_controls(from_batch_last(controls, like))
        return to_batch_last(cost(from_batch_last(states, like), padded), like).sum(0)

    first = x[0].unsqueeze(1).expand(-1, S, -1)
    rows = walk(step, first, torch.concatenate([x[:-1], u, gains], 1))[1]
    all_u, all_x = rows[:, :m], torch.concatenate([first.unsqueeze(0), rows[:, m:]])
    all_costs = torch.vmap(total, (2, 2))(all_x, all_u)
    all_costs = torch.where(all_costs.isfinite(), all_costs, torch.inf)
    best = (all_costs <= all_costs.amin(0) + noise).to(torch.uint8).argmax(0, keepdim=True)

    def chosen(paths: Float[Tensor, "t r S N"]) -> Float[Tensor, "t r N"]:
        index = best.expand(*paths.shape[:2], 1, -1)
        return paths.gather(2, index).squeeze(2)

    lowest = all_costs.gather(0, best).squeeze(0)
    return Trajectories(chosen(all_x), chosen(all_u), lowest, sizes[best.squeeze(0)])
