"""The planner: propose, score, start the differentiable MPC from the best, score, choose."""

from abc import ABC, abstractmethod
from copy import copy
from typing import NamedTuple, Self

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from diffstack_mmv.checks import message, require, require_at_least, require_whole
from diffstack_mmv.control import ILQR, Batched, TrajectoryOptimizer, pad_controls
from diffstack_mmv.costs import WeightedCost
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning.candidates import (
    CandidateFan,
    CandidateSource,
    as_told,
    roll_out,
)
from diffstack_mmv.planning.choice import Options, PlanChoice, TakeOptimum
from diffstack_mmv.planning.coordinates import Coordinates, PhysicalControls
from diffstack_mmv.planning.homotopy import best_of_each, homotopy_class
from diffstack_mmv.planning.limits import PlanConstraints
from diffstack_mmv.planning.objective import batched_objective
from diffstack_mmv.planning.plan_costs import PreparedCost
from diffstack_mmv.planning.pricing import CostScore, Plans, PlanScore, ScoredPlans, Situation
from diffstack_mmv.planning.problem import filled_up, initial_state, likeliest, possible
from diffstack_mmv.types import Motion, Obstacles, Plan, PlanningProblem, Solution, map_tensors

MOST_COMPARED = 256
"""Plans, the cheapest ones, whose homotopy classes are looked at."""
UNSAFE = 1e4
"""Added to the price of an unsafe plan where starts of the optimiser are chosen."""


class PlannerState(NamedTuple):
    """State carried over from the previous decision."""

    controls: Float[Tensor, "*b T m"]  # rest of the previous plan, continued to the horizon
    waited: Float[Tensor, "*b"]  # s in which the vehicle came no closer to its goal


class Planner(nn.Module, ABC):
    """Turns a batch of planning problems into plans."""

    @abstractmethod
    def forward(self, problem: PlanningProblem, state: PlannerState | None = None) -> Plan:
        """Plan for every problem, of the shape `*b`.

        Args:
            problem: The problems.
            state: What is known from the decision before; None for the first or only one.
        """


class MPCPlanner(Planner):
    """Propose → score → start k solves → score → choose.

    Training and closed loop use this same planner. Training scores by the cost, starts one solve
    and takes the optimum; closed loop scores by price and safety, starts from the best plans of
    different homotopy classes and takes the cheapest safe plan.

    Args:
        dynamics: The model that the plan obeys; shared with the predictor, so its parameters are
            learned once.
        cost: The learnable cost.
        solver: Trajectory optimiser; its implicit gradient reaches whatever dynamics, cost and
            problem depend on.
        candidates: Proposes plans.
        steps: Length of the horizon in steps of the model.
        score: What plans are worth.
        starts: Number of starts of the optimiser, each in another homotopy class where there are
            enough; with 0 the best proposal is chosen.
        choice: Which plan is driven.
        solved_components: Where agents have more components than this, the optimiser sees the
            likeliest one alone, while the score sees all; None shows it all.
        coordinates: In which the optimiser sees the controls; the controls themselves by default.
        constraints: What the optimiser keeps to besides the box of the controls; None: nothing.

    Raises:
        TypeError: There are constraints, but the solver is no `ILQR`.
        ValueError: The horizon is shorter than one step, the number of starts negative, no
            component left, or one of these no whole number.
    """

    def __init__(  # noqa: PLR0913 - each is a part that can be exchanged
        self,
        dynamics: DynamicsModel,
        cost: WeightedCost,
        solver: TrajectoryOptimizer,
        candidates: CandidateSource,
        steps: int = 30,
        score: PlanScore | None = None,
        starts: int = 1,
        choice: PlanChoice | None = None,
        solved_components: int | None = None,
        coordinates: Coordinates = PhysicalControls,
        constraints: PlanConstraints | None = None,
    ) -> None:
        super().__init__()
        most = 1 if solved_components is None else solved_components
        counts = ("steps", steps, 1), ("starts", starts, 0), ("solved_components", most, 1)
        for name, count, least in counts:
            require_whole(name, count)
            require_at_least(name, count, least)
        self.dynamics = dynamics
        self.cost = cost
        self.solver = solver
        self.candidates = candidates
        self.steps = steps
        self.score = score or CostScore()
        self.starts = starts
        self.choice = choice or TakeOptimum()
        self.solved_components = solved_components
        self.coordinates = coordinates
        self.constraints = constraints
        if constraints is not None and constraints.limits and not isinstance(solver, ILQR):
            found = type(solver).__name__
            raise TypeError(message("solver", "be an ILQR where there are constraints", found))

    def forward(self, problem: PlanningProblem, state: PlannerState | None = None) -> Plan:
        """Plan for every problem, `*b`; see `Planner`.

        The proposals are constants to the gradient; their logits carry it to the cost weights and
        to the problem where the score is differentiable, the solutions to these and to the dynamics
        as well.

        Raises:
            ValueError: Agents are foretold over another number of steps, or the problem is in
                single precision and the model in double.
        """
        self._require_fitting(problem)
        waited = torch.zeros_like(problem.reference_speed) if state is None else state.waited
        problem = problem._replace(obstacles=problem.obstacles.of_valid())

        situation = Situation(problem, self._costs(problem), waited, self.dynamics.dt_s)
        with torch.no_grad():
            fan = self.candidates(self.dynamics, problem, self.steps)
        plans = Plans(fan.controls, fan.motion)
        if state is not None:
            plans = plans.beside(self._continued(problem, state))
        proposals = self.score(plans, situation)
        with torch.no_grad():
            starts = self._best_starts(proposals, problem.obstacles)
        guess = plans.controls.take_along_dim(starts[..., None, None], -3)
        solution = self._solve(problem, guess)
        motion = self.dynamics.motion(solution.states, pad_controls(solution.controls))
        solved = Plans(solution.controls, motion)
        options = Options(proposals, fan.controls.shape[-3], solution, solved)
        chosen = self.choice(options, self.score, situation)
        return Plan(*chosen, solution, plans.motion, -proposals.cost)

    def compile_solver(self) -> None:
        """Have the solver and a `CandidateFan` compiled at their next use, if they can be."""
        if isinstance(self.solver, ILQR):
            self.solver = self.solver.compiled()
        if isinstance(self.candidates, CandidateFan):
            self.candidates.compile = True

    def with_dynamics(self, dynamics: DynamicsModel) -> Self:
        """The same planner for another model; all other parts are shared."""
        other = copy(self)
        # the copy of a module shares the mapping of its parts
        other._modules = {**self._modules, "dynamics": dynamics}
        return other

    @property
    def adds_components(self) -> bool:
        """Whether the cost is a sum over the components of all agents, see `CostTerm`."""
        return self.cost.adds_components

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
        controls = self._relative(pad_controls(plan.controls))
        weights = {
            name: weight.detach() if isinstance(weight, Tensor) else weight
            for name, weight in self.cost.weights().items()
        }
        parts = self.cost.components(plan.motion, controls, problem, weights)
        return {name: value.sum(-1) for name, value in parts.items()}

    def _require_fitting(self, problem: PlanningProblem) -> None:
        """Refuse another horizon, of which a library would take one time for another.

        And a problem that is less precise than the model.
        """
        given, own = problem.goal.dtype, self.dynamics.bounds.lower.dtype
        precise, remedy = torch.promote_types(given, own) == given, "Convert the one or the other."
        require(precise, "problem", f"be {own} as the dynamics", given, "", remedy)
        *_, agents, _, rows, _ = problem.obstacles.position.shape
        wanted = f"have {self.steps + 1} rows, for now and the end of each step"
        remedy = "Forecast as many steps as are planned."
        fits = rows == self.steps + 1 or agents == 0
        require(fits, "problem.obstacles.position", wanted, rows, "", remedy)

    def _costs(self, problem: PlanningProblem) -> PreparedCost:
        """The cost of plans, in a library where the solver is compiled."""
        return PreparedCost(self, problem, self._in_library, self.score.differentiable)

    @torch.no_grad()
    def _continued(self, problem: PlanningProblem, state: PlannerState) -> Plans:
        """The rest of the previous plan from the present state, as one more proposal."""
        controls = state.controls.unsqueeze(-3)
        rest = roll_out(self.dynamics, problem, controls, as_told, self._in_library)
        return Plans(rest.controls, rest.motion)

    @property
    def _in_library(self) -> bool:
        """Whether the solver is compiled, and all else with it."""
        return isinstance(self.solver, ILQR) and self.solver.compile

    def _best_starts(self, scored: ScoredPlans, obstacles: Obstacles) -> Int[Tensor, "*b k"]:
        """The best plan of each of the best homotopy classes around the likeliest futures."""
        price = torch.where(scored.safe, scored.cost, scored.cost + UNSAFE * (1 + scored.shortfall))
        if self.starts <= 1:
            return price.argmin(-1, keepdim=True)[..., : self.starts]
        agents = likeliest(obstacles)
        if price.dim() == 2:  # those who are not there pass on no side
            agents = possible(agents)
        cheapest = price.topk(min(MOST_COMPARED, price.shape[-1]), largest=False).indices
        paths = scored.plans.motion.position.take_along_dim(cheapest[..., None, None], -3)
        classes = homotopy_class(paths, agents.position.squeeze(-3))
        best = best_of_each(price.gather(-1, cheapest), classes, self.starts)
        return cheapest.gather(-1, best)

    def _solve(self, problem: PlanningProblem, guess: Float[Tensor, "*b k T m"]) -> Solution:
        """Optimise from every guess; all are one batch, so that finished ones are left behind."""
        shape, batch_dims = guess.shape[:-2], guess.dim() - 3
        obstacles, most = problem.obstacles, self.solved_components
        if most is not None and obstacles.weight.shape[-1] > most:
            problem = problem._replace(obstacles=likeliest(obstacles))
        if self._in_library and guess.shape[:-3].numel() > 1:
            problem = problem._replace(obstacles=filled_up(problem.obstacles))

        def repeated(entry: Tensor) -> Tensor:
            wide = entry.unsqueeze(batch_dims).expand(*shape, *entry.shape[batch_dims:])
            return wide.flatten(0, batch_dims)

        each, proposed = map_tensors(repeated, problem), guess.flatten(0, batch_dims)
        coordinates = self.coordinates(self.dynamics)
        cost = batched_objective(self, self.dynamics, each, coordinates)
        start = initial_state(self.dynamics, each.ego)
        first = coordinates.coordinates(start.detach(), proposed, self._in_library)
        solver, kept = self.solver, self.constraints
        if isinstance(solver, ILQR) and kept is not None and kept.limits and len(proposed):
            solution = kept.solve(solver, self.dynamics, coordinates, each, cost, first, start)
        else:
            solution = solver(Batched(coordinates.step), cost, coordinates.bounds, start, first)
        controls = coordinates.controls(solution.states[..., :-1, :], solution.controls)
        solution = solution._replace(controls=controls)
        return map_tensors(lambda entry: entry.unflatten(0, shape), solution)

    def _relative(self, controls: Float[Tensor, "*b t m"]) -> Float[Tensor, "*b t m"]:
        lower, upper = self.dynamics.bounds
        return controls / torch.maximum(upper, -lower)
