"""The cost and the score of many plans among many agents, some problems at a time."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from diffstack_mmv.planning.pricing import ScoredPlans
from diffstack_mmv.types import Motion, Obstacles, PlanningProblem, map_tensors

LARGEST = 1 << 17
"""Distances between plans and agents that are computed at once: their tensors stay in a cache."""

PlanCosts = Callable[[Motion, Tensor, PlanningProblem], Tensor]
Scores = Callable[[PlanningProblem, Tensor, Motion, Tensor], ScoredPlans]


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


def scored_in_parts(
    score: Scores,
    problem: PlanningProblem,
    controls: Float[Tensor, "*b C T m"],
    motion: Motion,
    waited: Float[Tensor, "*b"],
) -> ScoredPlans:
    """The score of plans without gradients, in half the time of all at once.

    Components of agents that are not there or impossible in all problems of a part are left out.

    Args:
        score: Of the problems of a batch.
        problem: The problems.
        controls: Of the plans.
        motion: Of the plans.
        waited: How long each vehicle has come no closer to its goal, s.
    """
    rows = _rows_at_once(controls, problem)
    if rows is None:
        return score(problem, controls, motion, waited)
    parts = []
    for first in range(0, len(controls), rows):
        everything = problem, controls, motion, waited
        own, *rest = map_tensors(lambda entry: entry[first : first + rows], everything)  # noqa: B023
        parts.append(score(own._replace(obstacles=possible(own.obstacles)), *rest)[2:])
    return ScoredPlans(controls, motion, *map(torch.cat, zip(*parts, strict=True)))


def possible(obstacles: Obstacles) -> Obstacles:
    """The components that are possible in some problem, each as an agent of its own.

    Scores add up or compare components of agents and agents in one way, so nothing else changes.

    Args:
        obstacles: Agents with one leading dimension, `b N K`.
    """
    there = obstacles.valid[..., None] & (obstacles.weight > 0)
    wanted = there.any(0).flatten().nonzero().squeeze(-1)
    if len(wanted) == there[0].numel() or not len(wanted):
        return obstacles
    return Obstacles(
        position=obstacles.position.flatten(1, 2)[:, wanted, None],
        weight=obstacles.weight.flatten(1, 2)[:, wanted, None],
        radius=obstacles.radius[..., None].expand_as(obstacles.weight).flatten(1, 2)[:, wanted],
        valid=there.flatten(1, 2)[:, wanted],
    )


def _rows_at_once(controls: Float[Tensor, "*b C t m"], problem: PlanningProblem) -> int | None:
    """How many problems fit into the cache; None where all do, or on another device."""
    if controls.dim() != 4 or controls.device.type != "cpu" or not len(controls):
        return None
    each = problem.obstacles.position[0].numel() // 2 * controls.shape[1]
    rows = max(1, LARGEST // max(each, 1))
    return rows if rows < len(controls) else None
