"""The planner: a fan of candidates, the cheapest of which starts the differentiable MPC."""

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.control import Cost, TrajectoryOptimizer
from diffstack_mmv.costs import WeightedCost
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning.candidates import CandidateFan, Candidates, with_final_row
from diffstack_mmv.types import Motion, Plan, PlanningProblem, map_tensors


class Planner(nn.Module, ABC):
    """Turns a batch of planning problems into plans."""

    @abstractmethod
    def forward(self, problem: PlanningProblem) -> Plan:
        """Plan for every problem."""


class MPCPlanner(Planner):
    """Candidates, then DiffMPC from the cheapest of them.

    Training and simulation use this same planner; they differ only in who builds the problem.

    Args:
        dynamics: The model that the plan obeys; shared with the predictor, so its parameters are
            learned once.
        cost: The learnable cost.
        solver: Trajectory optimiser; its implicit gradient reaches whatever dynamics, cost and
            problem depend on.
        candidates: The fan.
        steps: Length of the horizon in steps of the model.

    Raises:
        ValueError: The horizon is shorter than one step.
    """

    def __init__(
        self,
        dynamics: DynamicsModel,
        cost: WeightedCost,
        solver: TrajectoryOptimizer,
        candidates: CandidateFan,
        steps: int = 30,
    ) -> None:
        super().__init__()
        require_at_least("steps", steps, 1)
        self.dynamics = dynamics
        self.cost = cost
        self.solver = solver
        self.candidates = candidates
        self.steps = steps

    def cost_of(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Cost at each time of a motion under controls in SI units, whose last row is zero."""
        return self.cost(motion, self._relative(controls), problem)

    def hindsight_cost(
        self, plan: Plan, problem: PlanningProblem
    ) -> dict[str, Float[Tensor, "*b"]]:
        """Cost of a plan in another problem, e.g. under the true futures, by term, over all times.

        The weights are constants here: a cost must not be lowered by weighing its terms anew.
        """
        controls = self._relative(with_final_row(plan.solution.controls))
        weights = {
            name: torch.as_tensor(weight).detach() for name, weight in self.cost.weights().items()
        }
        parts = self.cost.components(plan.motion, controls, problem, weights)
        return {name: value.sum(-1) for name, value in parts.items()}

    def forward(self, problem: PlanningProblem) -> Plan:
        """Plan for every problem.

        The candidates are constants to the gradient; their logits carry it to the cost weights and
        to the problem, the solution to these and to the dynamics as well.
        """
        with torch.no_grad():
            fan = self.candidates(self.dynamics, problem, self.steps)
        logits = -self._score(fan, problem)
        best = logits.argmax(-1)[..., None, None, None]
        guess = fan.controls.take_along_dim(best, -3).squeeze(-3)
        solution = self.solver(
            self.dynamics,
            self.objective(problem),
            self.dynamics.bounds,
            self.dynamics.state_on_course(problem.motion),
            guess,
        )
        motion = self.dynamics.motion(solution.states, with_final_row(solution.controls))
        return Plan(solution, motion, fan.motion, logits)

    def objective(self, problem: PlanningProblem) -> Cost:
        """The cost of this problem as the solver wants it.

        (states, controls) -> cost at each time.
        """

        def cost(states: Tensor, controls: Tensor) -> Tensor:
            return self.cost_of(self.dynamics.motion(states, controls), controls, problem)

        return cost

    def _score(self, fan: Candidates, problem: PlanningProblem) -> Float[Tensor, "*b C"]:
        batch_dims = problem.goal.dim() - 1
        per_candidate = map_tensors(lambda field: field.unsqueeze(batch_dims), problem)
        return self.cost_of(fan.motion, with_final_row(fan.controls), per_candidate).sum(-1)

    def _relative(self, controls: Float[Tensor, "*b t m"]) -> Float[Tensor, "*b t m"]:
        lower, upper = self.dynamics.bounds
        return controls / torch.maximum(upper, -lower)
