"""DiffMPC in a receding horizon among pedestrians."""

from collections.abc import Callable, Sequence
from copy import copy
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning import (
    MPCPlanner,
    PlannerState,
    build_problem,
    predicted_obstacles,
    straight_reference,
)
from diffstack_mmv.simulation.decisions import Decided, batched, continued, unbatched
from diffstack_mmv.simulation.delay import DelayCompensation
from diffstack_mmv.simulation.forecasters import PedestrianForecaster
from diffstack_mmv.simulation.observation import Observation, in_precision_of
from diffstack_mmv.simulation.thoughts import Thought, joined, thought
from diffstack_mmv.types import (
    Ego,
    Forecast,
    HeadingOf,
    PlanningProblem,
    PlanOrigin,
    SolverStatus,
    map_tensors,
    taken,
)

PROGRESS_MPS = 0.2
"""A vehicle that comes closer to its goal than ever no faster than this is waiting."""
FEWEST = 5
"""Pedestrians that there is always room for."""


class Decision(NamedTuple):
    """What was decided in one control step, for the episodes that still ran."""

    origin: Int[Tensor, " r"]  # a PlanOrigin
    status: Int[Tensor, "r k"]  # a SolverStatus per start
    thought: Thought


class DiffMPCState(NamedTuple):
    """What the controller knows from the decisions before, for `b` episodes."""

    forecaster: Any  # the record of the forecaster
    plan: Float[Tensor, "b T m"]
    waited: Float[Tensor, " b"]  # s without progress
    nearest: Float[Tensor, " b"]  # m, smallest distance to the goal so far
    decisions: tuple[Decision, ...]


class DiffMPCController:
    """Forecasts the pedestrians, plans, and drives the first control of the plan.

    What a plan is worth, from how many starts it is optimised and which one is driven is up to the
    planner. All episodes are one batch; those that have ended are left out.

    Args:
        planner: Plans from a problem and the rest of the previous plan.
        forecaster: Predicts the pedestrians.
        cruise_mps: Cruising speed.
        dt_s: Time between two decisions.
        actuate: Turns controls of the planner's model into those of the robot.
        delay: Makes up for the time until a command acts, where it is known.

    Raises:
        ValueError: A number is not positive.
    """

    def __init__(
        self,
        planner: MPCPlanner,
        forecaster: PedestrianForecaster,
        cruise_mps: float = 3.0,
        dt_s: float = 0.25,
        actuate: Callable[[Tensor], Tensor] | None = None,
        delay: DelayCompensation | None = None,
    ) -> None:
        require_positive("cruise_mps", cruise_mps)
        require_positive("dt_s", dt_s)
        self.planner = planner
        self.forecaster = forecaster
        self.cruise_mps = cruise_mps
        self.dt_s = dt_s
        self.actuate = actuate
        self.delay = delay

    def with_model(self, model: DynamicsModel) -> Self:
        """The same controller, planning with another model of the vehicle."""
        other = copy(self)
        other.planner = self.planner.with_dynamics(model)
        return other

    def init(self, observation: Observation) -> DiffMPCState:
        """State at the start of episodes: no plan, no waiting."""
        observation = batched(observation)
        goal = observation.goal.to(self.planner.dynamics.bounds.lower)
        count, planner = len(goal), self.planner
        return DiffMPCState(
            forecaster=self.forecaster.init(observation),
            plan=goal.new_zeros(count, planner.steps, planner.dynamics.control_dim),
            waited=goal.new_zeros(count),
            nearest=goal.new_full((count,), torch.inf),
            decisions=(),
        )

    def act(self, state: DiffMPCState, observation: Observation) -> Decided:
        """First control of the chosen plan, in the units of the robot; the last for ended episodes.

        With gradients enabled and a planner that takes the optimum, the action is differentiable in
        cost weights, model, forecast and observed motion, so that a loss on whole episodes trains
        them through `World.step`. Solves that did not converge carry no gradient.

        Args:
            state: What `init` or the decision before gave.
            observation: All episodes, in one leading dimension or none.

        Returns:
            The action, and the state for the next decision.
        """
        if observation.time.dim() == 0:
            return unbatched(self, state, observation)
        planner, delay, step_s = self.planner, self.delay, self.planner.dynamics.dt_s
        steps = planner.steps + (0 if delay is None else delay.more_steps(step_s))
        told = self.forecaster(state.forecaster, observation, step_s, steps)
        if delay is not None:
            told = told._replace(forecast=delay.forecast(told.forecast, step_s))
            observation = delay.observation(observation, state.plan[:, 0])
        problem = self.problem(observation, told.forecast)
        state = self._progressed(state, problem)._replace(forecaster=told.state)
        rows = observation.running.nonzero().squeeze(-1)
        rest = continued(state.plan[rows], self.dt_s / step_s)
        before = PlannerState(rest, state.waited[rows])
        plan = planner(map_tensors(lambda entry: entry[rows], problem), before)
        controls = state.plan.index_copy(0, rows, plan.controls)
        action = controls[:, 0] if self.actuate is None else self.actuate(controls[:, 0])
        expected = thought(plan, _of_present(observation, told.forecast), rows)
        decision = Decision(plan.origin, plan.solution.status, expected)
        decisions = (*state.decisions, decision)
        return Decided(action, state._replace(plan=controls.detach(), decisions=decisions))

    def problem(self, observation: Observation, forecast: Forecast) -> PlanningProblem:
        """The planning problem of an observation, `*b`, in the precision of the dynamics."""
        like = self.planner.dynamics.bounds.lower
        seen, told = in_precision_of(like, (observation, forecast))
        seen_agents = _present_first(seen, told)
        return build_problem(
            Ego(seen.motion, HeadingOf.BODY, seen.discs),
            seen.goal,
            straight_reference(seen.motion, seen.goal, self.planner.steps, self.cruise_mps),
            predicted_obstacles(*seen_agents),
        )

    def diagnosis(self, state: DiffMPCState) -> dict[str, Float[Tensor, " E"]]:
        """Per episode: share of its decisions by origin, and of its solves that converged."""
        count = len(state.plan)
        rows = torch.cat([decision.thought.rows for decision in state.decisions])
        origin = torch.cat([decision.origin for decision in state.decisions])
        status = torch.cat([decision.status for decision in state.decisions])
        total = torch.zeros(count).index_add(0, rows, torch.ones(len(rows)))

        def share(values: Tensor) -> Tensor:
            return torch.zeros(count).index_add(0, rows, values.float()) / total

        shares = {f"{each.name.lower()}_share": share(origin == each) for each in PlanOrigin}
        if status.shape[-1] == 0:
            return shares
        solved = (status == SolverStatus.CONVERGED).float().mean(-1)
        return shares | {"solved_share": share(solved)}

    def thoughts(self, state: DiffMPCState) -> dict[str, Float[np.ndarray, "E S *d"]]:
        """Per episode and decision: the plan in m, and what was expected of each pedestrian."""
        return joined([decision.thought for decision in state.decisions], len(state.plan))

    def _progressed(self, state: DiffMPCState, problem: PlanningProblem) -> DiffMPCState:
        """Count how long each vehicle has come no closer to its goal."""
        with torch.no_grad():
            way = (problem.goal - problem.ego.motion.position).norm(dim=-1)
            advances = way < state.nearest - PROGRESS_MPS * self.dt_s
            nearest = torch.where(advances, way, state.nearest)
            more = torch.where(advances, -0.5 * self.dt_s, self.dt_s)
            return state._replace(nearest=nearest, waited=(state.waited + more).clamp_min(0))


class _People(NamedTuple):
    """What obstacles are made of."""

    position: Float[Tensor, "*b n 2"]  # m
    radius: Float[Tensor, "*b n"]  # m
    present: Bool[Tensor, "*b n"]
    forecast: Forecast  # *b n K T


def _present_first(seen: Observation, forecast: Forecast) -> _People:
    """The pedestrians, without much room for those who are absent in all episodes.

    The cost of planning grows with the number of obstacles, whether they are there or not, but a
    compiled solver belongs to one number: there is room for 5, 10, 20 and so on.
    """
    present = seen.seen.bool()
    everybody = _People(seen.pedestrian_position, seen.pedestrian_radius, present, forecast)
    room = FEWEST
    while room < (int(present.sum(-1).max()) if present.numel() else 0):
        room *= 2
    if room >= present.shape[-1]:
        return everybody
    return taken(everybody, (~present).long().argsort(dim=-1, stable=True)[..., :room])


def _of_present(seen: Observation, forecast: Forecast) -> Forecast:
    """A forecast to look at: NaN for those who are absent."""
    present = seen.seen[..., None, None, None]
    return forecast._replace(mean=torch.where(present, forecast.mean, torch.nan))


def merged(decisions: Sequence[Decision]) -> Decision:
    """One decision of those made at the same time for different episodes."""
    return map_tensors(lambda *entries: torch.cat(entries), *decisions)
