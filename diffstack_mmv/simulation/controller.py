"""DiffMPC in a receding horizon among people."""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.planning import Candidates, MPCPlanner, with_final_row
from diffstack_mmv.simulation.homotopy import best_of_each, ways_around
from diffstack_mmv.simulation.people import PeopleForecast
from diffstack_mmv.simulation.safety import SafetyMargin, clearance_of
from diffstack_mmv.simulation.world import Observation
from diffstack_mmv.types import (
    Motion,
    Obstacles,
    PlanningProblem,
    Solution,
    SolverStatus,
    map_tensors,
)


STANDING_MPS = 0.1
"""Below this speed a vehicle counts as waiting."""


class Choice(IntEnum):
    """Where the plan that is driven comes from."""

    CANDIDATE = 0
    PREVIOUS = 1
    OPTIMISED = 2
    FALLBACK = 3


class Decision(NamedTuple):
    """What was decided in one control step."""

    choice: Int[Tensor, "*b"]  # a Choice
    status: Int[Tensor, "*b k"]  # a SolverStatus per start
    rows: Int[Tensor, "*b"]  # index of the episode


class _Scored(NamedTuple):
    """Plans with their price."""

    controls: Float[Tensor, "*b C T m"]
    position: Float[Tensor, "*b C T1 2"]
    cost: Float[Tensor, "*b C"]
    safe: Bool[Tensor, "*b C"]
    shortfall: Float[Tensor, "*b C"]


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
        margin: Clearance asked of a plan.
        cruise_mps: Cruising speed.
        dt_s: Time between two decisions.
        starts: Number of starts of the optimiser; 0 drives the best candidate.
        comfort_weight: Price of the lack of comfortable clearance in 1/(m² s).
        time_weight: Price of a second before the arrival, in 1/s.
        patience_s: Time of standing after which the comfortable clearance counts half as much.
        goal_tolerance_m: A plan has arrived where it is closer than this to the goal.
        actuate: Turns controls of the planner's model into those of the robot.

    Raises:
        ValueError: A number is out of range.
    """

    def __init__(
        self,
        planner: MPCPlanner,
        people: PeopleForecast,
        margin: SafetyMargin | None = None,
        cruise_mps: float = 3.0,
        dt_s: float = 0.25,
        starts: int = 3,
        comfort_weight: float = 30.0,
        time_weight: float = 1.0,
        patience_s: float = 1.0,
        goal_tolerance_m: float = 0.25,
        actuate: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        require_positive("cruise_mps", cruise_mps)
        require_positive("dt_s", dt_s)
        require_at_least("starts", starts, 0)
        require_at_least("comfort_weight", comfort_weight, 0)
        self.planner = planner
        self.people = people
        self.margin = margin or SafetyMargin()
        self.cruise_mps = cruise_mps
        self.dt_s = dt_s
        self.starts = starts
        self.comfort_weight = comfort_weight
        self.time_weight = time_weight
        self.patience_s = patience_s
        self.goal_tolerance_m = goal_tolerance_m
        self.actuate = actuate
        self.decisions: list[Decision] = []
        self._waited = torch.zeros(0)
        self._comfort = torch.zeros(0)
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
            rows = observation.running.nonzero().squeeze(-1)
            if not self._continues(observation):
                like, size = problem.goal, (len(observation.time), self.planner.steps)
                self._plan = like.new_zeros(*size, self.planner.dynamics.control_dim)
                self._waited, self.decisions = torch.zeros_like(like[:, 0]), []
            running = map_tensors(lambda field: field[rows], problem)
            standing = problem.motion.velocity[:, 0] < STANDING_MPS
            self._waited = torch.where(standing, self._waited + self.dt_s, 0.0)
            self._comfort = self.comfort_weight * 0.5 ** (self._waited[rows] / self.patience_s)
            self._plan[rows] = self._decided(running, self._candidates(running, rows), rows)
        action = self._plan[:, 0]
        return action if self.actuate is None else self.actuate(action)

    def _continues(self, observation: Observation) -> bool:
        """Whether these are the episodes of the step before."""
        same = self._plan.shape[0] == observation.time.shape[0]
        return same and not bool((observation.time == 0).any())

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

    def _candidates(self, problem: PlanningProblem, rows: Int[Tensor, " r"]) -> _Scored:
        """The fan, then the rest of the previous plan."""
        dynamics = self.planner.dynamics
        fan = self.planner.candidates(dynamics, problem, self.planner.steps)
        rest = self._rolled_out(problem, self._shifted(self._plan[rows]).unsqueeze(-3))
        priced = (self._priced(problem, each.controls, each.motion) for each in (fan, rest))
        return _joined(*priced)

    def _shifted(self, controls: Float[Tensor, "*b T m"]) -> Float[Tensor, "*b T m"]:
        """A plan after the time of one decision; its last control is held on."""
        steps = controls.shape[-2]
        ahead = torch.arange(steps, device=controls.device) + self.dt_s / self.planner.dynamics.dt_s
        return controls[..., ahead.floor().long().clamp(max=steps - 1), :]

    def _rolled_out(
        self, problem: PlanningProblem, controls: Float[Tensor, "*b C T m"]
    ) -> Candidates:
        """Motions under given controls."""
        dynamics = self.planner.dynamics
        start = dynamics.initial_state(problem.motion).unsqueeze(-2)
        states = [start.expand(*controls.shape[:-2], start.shape[-1])]
        for control in controls.unbind(-2):
            states.append(dynamics(states[-1], control))
        stacked = torch.stack(states, -2)
        return Candidates(stacked, controls, dynamics.motion(stacked, with_final_row(controls)))

    def _priced(
        self, problem: PlanningProblem, controls: Float[Tensor, "*b C T m"], motion: Motion
    ) -> _Scored:
        """Cost and safety of plans."""
        per_plan = map_tensors(lambda field: field.unsqueeze(problem.goal.dim() - 1), problem)
        running = self.planner.cost_of(motion, with_final_row(controls), per_plan)
        running = running + self.time_weight * self.planner.dynamics.dt_s
        cost = (running * self._under_way(motion, per_plan)).sum(-1)
        reach = problem.radius[..., None] + problem.obstacles.radius
        people = problem.obstacles.position.squeeze(-3)
        clearance = clearance_of(motion.position, people, reach)
        walked = people.diff(dim=-2).square().sum(-1).sqrt().cumsum(-1)
        safety = self.margin(clearance, walked.unsqueeze(-3), self.planner.dynamics.dt_s)
        total = cost + self._comfort[:, None] * safety.penalty
        usable = total.isfinite()
        return _Scored(
            controls,
            motion.position,
            torch.where(usable, total, torch.inf),
            safety.safe & usable,
            torch.where(usable, safety.shortfall, torch.inf),
        )

    def _under_way(self, motion: Motion, problem: PlanningProblem) -> Bool[Tensor, "*b T1"]:
        """Times up to the arrival: how a plan goes on behind the goal is not priced."""
        way = problem.goal.unsqueeze(-2) - motion.position
        arrived = way.square().sum(-1) < self.goal_tolerance_m**2
        return (arrived.long().cumsum(-1) - arrived.long()) == 0

    def _decided(
        self, problem: PlanningProblem, plans: _Scored, rows: Int[Tensor, " r"]
    ) -> Float[Tensor, "*b T m"]:
        """The plan to drive."""
        fan_size = plans.cost.shape[-1] - 1
        solved = None
        if self.starts:
            solved = self._solve(problem, plans)
            controls = solved.controls
            motion = self.planner.dynamics.motion(solved.states, with_final_row(controls))
            plans = _joined(plans, self._priced(problem, controls, motion))
        order = torch.where(plans.safe, plans.cost, torch.inf)
        best = order.argmin(-1)
        hopeless = ~plans.safe.any(-1)
        least = plans.shortfall + 1e-6 * plans.cost.clamp(max=1e4)
        best = torch.where(hopeless, least.argmin(-1), best)
        ends = (fan_size, plans.cost.shape[-1])
        self.decisions.append(_decision(best, hopeless, ends, solved, rows))
        return plans.controls.take_along_dim(best[..., None, None, None], -3).squeeze(-3)

    def _solve(self, problem: PlanningProblem, plans: _Scored) -> Solution:
        """Optimise from the best plan of each of the best ways around the people, `*b k`."""
        ways = ways_around(plans.position, problem.obstacles.position.squeeze(-3))
        price = torch.where(plans.safe, plans.cost, plans.cost + 1e4 * (1 + plans.shortfall))
        chosen = best_of_each(price, ways, self.starts)
        at = problem.goal.dim() - 1
        many = map_tensors(
            lambda field: field.unsqueeze(at).expand(
                *field.shape[:at], self.starts, *field.shape[at:]
            ),
            problem,
        )
        planner = self.planner
        return planner.solver(
            planner.dynamics,
            planner.objective(many),
            planner.dynamics.bounds,
            planner.dynamics.initial_state(many.motion),
            plans.controls.take_along_dim(chosen[..., None, None], -3),
        )


def _joined(first: _Scored, second: _Scored) -> _Scored:
    """Plans side by side."""
    at = first.cost.dim() - 1
    return _Scored(*(torch.cat(pair, at) for pair in zip(first, second, strict=True)))


def _decision(
    best: Int[Tensor, " r"],
    hopeless: Bool[Tensor, " r"],
    ends: tuple[int, int],
    solved: Solution | None,
    rows: Int[Tensor, " r"],
) -> Decision:
    """Record where the chosen plans come from; plans are the fan, the previous plan, solutions."""
    fan_size, plans = ends
    status = best.new_zeros(len(best), 0) if solved is None else solved.status
    choice = torch.full_like(best, Choice.PREVIOUS)
    choice = torch.where(best < fan_size, Choice.CANDIDATE, choice)
    choice = torch.where(best >= plans - status.shape[-1], Choice.OPTIMISED, choice)
    choice = torch.where(hopeless, Choice.FALLBACK, choice)
    return Decision(choice, status, rows)
