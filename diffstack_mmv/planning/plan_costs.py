"""The cost of many plans of the same problems, prepared once; some problems at a time."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from diffstack_mmv.control import pad_controls
from diffstack_mmv.control.native.prices import Pricer, pricer
from diffstack_mmv.planning.objective import HasPlanCost, motion_cost, motion_rows
from diffstack_mmv.planning.problem import filled_up, possible
from diffstack_mmv.types import Motion, PlanningProblem, map_tensors, on_host

MOST_PRICED = 128
"""Components of agents up to which a score without gradient is priced in a library: five people of
whom each may walk off in 24 directions are 125."""
LARGEST = 1 << 17
"""Distances between plans and agents that are computed at once: their tensors stay in a cache."""

CostFunction = Callable[[Motion, Tensor, PlanningProblem], Tensor]
"""(motion, controls, problem) -> cost of plans at each time."""


class PreparedCost:
    """Cost at each time of any plans of some problems.

    Proposals and solutions are plans of the same problems: what a library has to know of these is
    found out at the first call.

    Args:
        planner: Whose cost it is.
        problem: The problems, `*b`.
        in_library: Whether a library may be generated.
        differentiable: Whether the cost has to carry gradients; without them impossible components
            of agents are left out, where the cost adds up components.
    """

    def __init__(
        self, planner: HasPlanCost, problem: PlanningProblem, in_library: bool, differentiable: bool
    ) -> None:
        self.planner = planner
        self.problem = problem
        self.differentiable = differentiable
        self._prices: Pricer | None = None
        goals = problem.goal
        self._is_possible = in_library and goals.dim() == 2 and len(goals) > 0

    def __call__(
        self, motion: Motion, controls: Float[Tensor, "*b C T m"]
    ) -> Float[Tensor, "*b C T1"]:
        """Cost of plans, given their motion and their controls in SI units."""
        padded = pad_controls(controls)
        if self._is_possible:
            rows = motion_rows(motion)
            self._prices = self._prices or self._prepared(rows, padded)
            self._is_possible = self._prices is not None
            found = self._prices(rows, padded) if self._prices else None
            if found is not None:
                return found
        batch_dims = self.problem.goal.dim() - 1
        per_plan = map_tensors(lambda entry: entry.unsqueeze(batch_dims), self.problem)
        return cost_in_parts(self.planner.cost_of, motion, padded, per_plan)

    def _prepared(self, rows: Tensor, controls: Tensor) -> Pricer | None:
        agents = self.problem.obstacles
        if not self.differentiable:
            agents = possible(agents) if self.planner.adds_components else agents
            if agents.weight[0].numel() > MOST_PRICED:
                return None
        problem = self.problem._replace(obstacles=filled_up(agents))
        return pricer(motion_cost(self.planner, problem), rows, controls)


def cost_in_parts(
    cost: CostFunction,
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


def _rows_at_once(controls: Float[Tensor, "*b C t m"], problem: PlanningProblem) -> int | None:
    """How many problems fit into the cache; None where all do, or on another device."""
    if controls.dim() != 4 or not on_host(controls) or not len(controls):
        return None
    each = problem.obstacles.position[0].numel() // 2 * controls.shape[1]
    rows = max(1, LARGEST // max(each, 1))
    return rows if rows < len(controls) else None
