"""The cost of many plans of the same problems, prepared once."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control import pad_controls
from diffstack_mmv.control.native.prices import Pricer, pricer
from diffstack_mmv.planning.objective import PlanCost, motion_cost, motion_rows
from diffstack_mmv.planning.parts import cost_in_parts, possible
from diffstack_mmv.planning.problem import filled_up
from diffstack_mmv.types import Motion, PlanningProblem, map_tensors

MOST_PRICED = 128
"""Components of agents up to which a score without gradient is priced in a library: five people of
whom each may walk off in 24 directions are 125."""


class PlanCosts:
    """Cost at each time of any plans of some problems.

    Proposals and solutions are plans of the same problems: what a library has to know of these is
    found out at the first call.

    Args:
        planner: Whose cost it is.
        problem: The problems, `*b`.
        in_library: Whether a library may be generated.
        differentiable: Whether the cost has to carry gradients; without them impossible components
            of agents are left out.
    """

    def __init__(
        self, planner: PlanCost, problem: PlanningProblem, in_library: bool, differentiable: bool
    ) -> None:
        self.planner = planner
        self.problem = problem
        self.differentiable = differentiable
        self._prices: Pricer | None = None
        self._is_possible = in_library and problem.goal.dim() == 2

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
            agents = possible(agents)
            if agents.weight[0].numel() > MOST_PRICED:
                return None
        problem = self.problem._replace(obstacles=filled_up(agents))
        return pricer(motion_cost(self.planner, problem), rows, controls)
