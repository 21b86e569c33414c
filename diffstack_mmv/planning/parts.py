"""The cost of many plans among many agents, some problems at a time."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from diffstack_mmv.types import Motion, Obstacles, PlanningProblem, map_tensors, on_host

LARGEST = 1 << 17
"""Distances between plans and agents that are computed at once: their tensors stay in a cache."""

PlanCosts = Callable[[Motion, Tensor, PlanningProblem], Tensor]


def cost_in_parts(
    cost: PlanCosts,
    motion: Motion,
    controls: Float[Tensor, "*b C t m"],
    problem: PlanningProblem,
) -> Float[Tensor, "*b C t"]:
    """The cost of plans at each time, computed again in the backward pass where it is large.

    Nothing is then kept of the distances between all plans and all agents: memory is bounded, and a
    processor works in its cache.

    Args:
        cost: Of the problems of a batch.
        motion: Of the plans.
        controls: With the row beside the final state.
        problem: One for each row of the batch, with a dimension for the plans.
    """
    rows = _rows_at_once(controls, problem)
    if rows is None:
        return cost(motion, controls, problem)
    parts = []
    for first in range(0, len(controls), rows):
        own = map_tensors(lambda entry: entry[first : first + rows], (motion, controls, problem))  # noqa: B023
        if torch.is_grad_enabled():
            part = checkpoint(cost, *own, use_reentrant=False, preserve_rng_state=False)
        else:
            part = cost(*own)
        parts.append(part)
    return torch.cat(parts)


def possible(obstacles: Obstacles) -> Obstacles:
    """The components of each problem that are possible, each as an agent of its own.

    Costs and scores add up or compare components of agents and agents in one way, so nothing else
    changes. Problems with fewer than the others get absent ones. On a device all are kept: to count
    them the host would have to wait.

    Args:
        obstacles: Agents with one leading dimension, `b N K`.
    """
    if not on_host(obstacles.weight):
        return obstacles
    there = (obstacles.valid[..., None] & (obstacles.weight > 0)).flatten(1)
    most = int(there.sum(-1).max()) if there.numel() else 0
    if most == there.shape[-1] or not most:
        return obstacles
    order = (~there).long().argsort(dim=-1, stable=True)[:, :most]
    weight = obstacles.weight.flatten(1).gather(1, order)
    radius = obstacles.radius[..., None].expand_as(obstacles.weight).flatten(1)
    return Obstacles(
        position=obstacles.position.flatten(1, 2)
        .take_along_dim(order[..., None, None], 1)
        .unsqueeze(2),
        weight=weight.unsqueeze(-1),
        radius=radius.gather(1, order),
        valid=there.gather(1, order),
    )


def _rows_at_once(controls: Float[Tensor, "*b C t m"], problem: PlanningProblem) -> int | None:
    """How many problems fit into the cache; None where all do, or on another device."""
    if controls.dim() != 4 or not on_host(controls) or not len(controls):
        return None
    each = problem.obstacles.position[0].numel() // 2 * controls.shape[1]
    rows = max(1, LARGEST // max(each, 1))
    return rows if rows < len(controls) else None
