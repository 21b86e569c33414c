"""The cost of many plans among many agents, some problems at a time."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from diffstack_mmv.types import Motion, PlanningProblem, map_tensors

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
    obstacles = problem.obstacles.position
    each = obstacles[0].numel() // 2 * controls.shape[1] if len(obstacles) else 0
    rows = max(1, LARGEST // max(each, 1))
    if controls.dim() != 4 or rows >= len(controls) or controls.device.type != "cpu":
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
