"""DiffMPC in a receding horizon among people."""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.dynamics import rollout
from diffstack_mmv.planning import MPCPlanner, with_final_row
from diffstack_mmv.simulation.homotopy import best_of_each, ways_around
from diffstack_mmv.simulation.people import PeopleForecast
from diffstack_mmv.simulation.pricing import PlanPrice, PricedPlans
from diffstack_mmv.simulation.world import Observation
from diffstack_mmv.types import (
    Motion,
    Obstacles,
    PlanningProblem,
    Solution,
    SolverStatus,
    map_tensors,
)

PROGRESS_M = 0.05
"""A vehicle that comes closer to its goal than ever by less than this per decision is waiting."""
UNSAFE = 1e4
"""Added to the price of an unsafe plan where starts of the optimiser are chosen."""


class Choice(IntEnum):
    """Where the plan that is driven comes from."""

    CANDIDATE = 0
    PREVIOUS = 1
    OPTIMISED = 2
    FALLBACK = 3


class Decision(NamedTuple):
    """What was decided in one control step, for the episodes that still ran."""

    choice: Int[Tensor, " r"]  # a Choice
    status: Int[Tensor, "r k"]  # a SolverStatus per start
    rows: Int[Tensor, " r"]  # index of the episode


class DiffMPCController:
    """Chooses the best safe plan among candidates and the MPC solutions started from them.

    In every step: the people are forecast; a fan of manoeuvres and the rest of the previous plan
    are rolled out; each is priced by the planner's cost plus the lack of comfortable clearance, and
    refused where its clearance is unsafe; the best safe candidates of different ways around the
    people start the optimiser; a solution replaces them only where it is safe and cheaper. Where
    nothing is safe, the plan with the least lack of clearance is driven, maximal braking among
    them. All episodes are one batch; a time of zero starts new ones.

    Args:
        planner: Dynamics, cost, solver, fan and horizon.
        people: Forecast of the humans.
        price: Price and safety of a plan.
        cruise_mps: Cruising speed.
        dt_s: Time between two decisions.
        starts: Number of starts of the optimiser; 0 drives the best candidate.
        actuate: Turns controls of the planner's model into those of the robot.

    Raises:
        ValueError: A number is out of range.
    """

    def __init__(
        self,
        planner: MPCPlanner,
        people: PeopleForecast,
        price: PlanPrice | None = None,
        cruise_mps: float = 3.0,
        dt_s: float = 0.25,
        starts: int = 1,
        actuate: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        require_positive("cruise_mps", cruise_mps)
        require_positive("dt_s", dt_s)
        require_at_least("starts", starts, 0)
        self.planner = planner
        self.people = people
        self.price = price or PlanPrice()
        self.cruise_mps = cruise_mps
        self.dt_s = dt_s
        self.starts = starts
        self.actuate = actuate
        self.decisions: list[Decision] = []
        self._waited = torch.zeros(0)
        self._nearest = torch.zeros(0)
        self._plan = torch.zeros(0, planner.steps, planner.dynamics.control_dim)

    def __call__(self, observation: Observation) -> Float[Tensor, "*b m"]:
        """First control of the chosen plan, in the units of the robot; zero for ended episodes.

        Args:
            observation: All episodes, in one leading dimension or none.

        Returns:
            The action.
        """
        if observation.time.dim() == 0:
            return self(map_tensors(lambda field: field.unsqueeze(0), observation)).squeeze(0)
        with torch.no_grad():
            problem = self.problem(observation)
            self._remember(observation, problem)
            rows = observation.running.nonzero().squeeze(-1)
            running = map_tensors(lambda field: field[rows], problem)
            self._plan[rows] = self._decided(running, rows)
        return self._actuated(self._plan[:, 0])

    def optimised(self, observation: Observation) -> Float[Tensor, "b m"]:
        """First control of the MPC solution alone, differentiable, in the units of the robot.

        The start of the optimiser is chosen as ever and is a constant; the gradient reaches cost
        weights, model, forecast and the observed motion, so that a loss on whole episodes trains
        them through `World.step`. Solves that did not converge carry no gradient.

        Args:
            observation: All episodes, in one leading dimension.

        Returns:
            The action.
        """
        problem = self.problem(observation)
        with torch.no_grad():
            self._remember(observation, problem)
            everybody = torch.arange(len(self._waited))
            plans = self._candidates(problem, everybody)
        solution = self._solve(problem, plans)
        self._plan = solution.controls[:, 0].detach()
        return self._actuated(solution.controls[:, 0, 0])

    def _actuated(self, control: Float[Tensor, "b m"]) -> Float[Tensor, "b m"]:
        """The control in the units of the robot."""
        return control if self.actuate is None else self.actuate(control)

    def _remember(self, observation: Observation, problem: PlanningProblem) -> None:
        """Begin anew at the start of episodes; count how long each came no closer to its goal."""
        count, goal = len(observation.time), problem.goal
        if len(self._plan) != count or bool((observation.time == 0).any()):
            size = (count, self.planner.steps, self.planner.dynamics.control_dim)
            self._plan, self._waited = goal.new_zeros(size), goal.new_zeros(count)
            self._nearest = goal.new_full((count,), torch.inf)
            self.decisions = []
        way = (problem.goal - problem.motion.position).norm(dim=-1)
        advances = way < self._nearest - PROGRESS_M
        self._nearest = torch.where(advances, way, self._nearest)
        more = torch.where(advances, -0.5 * self.dt_s, self.dt_s)
        self._waited = (self._waited + more).clamp_min(0)

    def diagnosis(self) -> dict[str, Float[Tensor, " E"]]:
        """Per episode: share of its decisions by origin, and of its solves that converged."""
        rows = torch.cat([decision.rows for decision in self.decisions])
        choice = torch.cat([decision.choice for decision in self.decisions])
        status = torch.cat([decision.status for decision in self.decisions])
        solved = (status == SolverStatus.CONVERGED).float().mean(-1) if self.starts else None
        total = torch.zeros(len(self._plan)).index_add(0, rows, torch.ones(len(rows)))

        def share(values: Tensor) -> Tensor:
            return torch.zeros(len(self._plan)).index_add(0, rows, values.float()) / total

        shares = {f"{each.name.lower()}_share": share(choice == each) for each in Choice}
        return shares if solved is None else shares | {"solved_share": share(solved)}

    def problem(self, observation: Observation) -> PlanningProblem:
        """The planning problem of an observation, `*b`, in the precision of the dynamics."""
        steps, dynamics = self.planner.steps, self.planner.dynamics
        forecast = self.people(observation, dynamics.dt_s, steps)
        like = dynamics.bounds.lower
        position = forecast.unsqueeze(-3).to(like)
        radius = observation.human_radius.to(like)
        motion = Motion(*(field.to(like) for field in observation.motion))
        goal = observation.goal.to(like)
        share = torch.linspace(0, 1, steps + 1, dtype=like.dtype, device=like.device)[:, None]
        now = motion.position.unsqueeze(-2)
        return PlanningProblem(
            motion=motion,
            goal=goal,
            reference=now + share * (goal.unsqueeze(-2) - now),
            reference_speed=torch.full_like(goal[..., 0], self.cruise_mps),
            radius=observation.radius.to(like),
            obstacles=Obstacles(
                position=position,
                weight=torch.ones_like(position[..., 0, 0]),
                radius=radius,
                valid=torch.ones_like(radius, dtype=torch.bool),
            ),
        )

    def _candidates(self, problem: PlanningProblem, rows: Int[Tensor, " r"]) -> PricedPlans:
        """The fan, its last plan being maximal braking, then the rest of the previous plan."""
        planner, dynamics = self.planner, self.planner.dynamics
        fan = planner.candidates(dynamics, problem, planner.steps)
        controls = self._shifted(self._plan[rows]).unsqueeze(1)
        states = rollout(dynamics, dynamics.initial_state(problem.motion).unsqueeze(1), controls)
        rest = dynamics.motion(states, with_final_row(controls))
        waited = self._waited[rows]
        priced = self.price(planner, problem, fan.controls, fan.motion, waited)
        return priced.beside(self.price(planner, problem, controls, rest, waited))

    def _shifted(self, controls: Float[Tensor, "*b T m"]) -> Float[Tensor, "*b T m"]:
        """A plan after the time of one decision; its last control is held on."""
        steps = controls.shape[-2]
        ahead = torch.arange(steps, device=controls.device) + self.dt_s / self.planner.dynamics.dt_s
        return controls[..., ahead.floor().long().clamp(max=steps - 1), :]

    def _decided(self, problem: PlanningProblem, rows: Int[Tensor, " r"]) -> Float[Tensor, "r T m"]:
        """The plan to drive."""
        plans = self._candidates(problem, rows)
        fan_size = plans.cost.shape[-1] - 1
        status = rows.new_zeros(len(rows), 0)
        if self.starts:
            solution = self._solve(problem, plans)
            status, controls = solution.status, solution.controls
            motion = self.planner.dynamics.motion(solution.states, with_final_row(controls))
            solved = self.price(self.planner, problem, controls, motion, self._waited[rows])
            plans = plans.beside(solved)
        # where no plan is finite, as after a divergence of the model, brake
        nothing = plans.cost.isinf().all(-1)
        best = torch.where(nothing, fan_size - 1, plans.best())
        self.decisions.append(_decision(best, plans, fan_size, status, rows))
        return plans.controls.take_along_dim(best[:, None, None, None], 1).squeeze(1)

    def _solve(self, problem: PlanningProblem, plans: PricedPlans) -> Solution:
        """Optimise from the best plan of each of the best ways around the people, `r k`."""
        planner = self.planner
        ways = ways_around(plans.position, problem.obstacles.position.squeeze(-3))
        price = torch.where(plans.safe, plans.cost, plans.cost + UNSAFE * (1 + plans.shortfall))
        chosen = best_of_each(price, ways, self.starts)
        many = map_tensors(
            lambda field: field.unsqueeze(1).expand(-1, self.starts, *field.shape[1:]), problem
        )
        return planner.solver(
            planner.dynamics,
            planner.objective(many),
            planner.dynamics.bounds,
            planner.dynamics.initial_state(many.motion),
            plans.controls.take_along_dim(chosen[..., None, None], 1),
        )


def _decision(
    best: Int[Tensor, " r"],
    plans: PricedPlans,
    fan_size: int,
    status: Int[Tensor, "r k"],
    rows: Int[Tensor, " r"],
) -> Decision:
    """Record where the chosen plans come from; plans are the fan, the previous plan, solutions."""
    choice = torch.full_like(best, Choice.PREVIOUS)
    choice = torch.where(best < fan_size, Choice.CANDIDATE, choice)
    choice = torch.where(best > fan_size, Choice.OPTIMISED, choice)
    return Decision(torch.where(plans.safe.any(-1), choice, Choice.FALLBACK), status, rows)
