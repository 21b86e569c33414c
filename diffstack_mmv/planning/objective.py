"""The cost of planning problems as a solver wants it: able to select some of its problems."""

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control import Batched
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning.coordinates import ControlCoordinates
from diffstack_mmv.types import Discs, Ego, HeadingOf, Motion, Obstacles, PlanningProblem

NAMES = (
    *Motion._fields,
    *(f"ego_disc_{name}" for name in Discs._fields),
    "goal",
    "reference",
    "reference_speed",
    *(f"obstacle_{name}" for name in Obstacles._fields),
)
"""Names of the tensors of a problem, in their order."""


@runtime_checkable
class HasPlanCost(Protocol):
    """What an objective needs of a planner."""

    @property
    def adds_components(self) -> bool:
        """Whether the cost is a sum over the components of all agents, each times its weight."""
        ...

    def cost_of(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Cost at each time of a motion."""
        ...


def batched_objective(
    planner: HasPlanCost,
    dynamics: DynamicsModel,
    problem: PlanningProblem,
    coordinates: ControlCoordinates,
) -> Batched:
    """Cost at each time, of states and coordinates of controls, of a batch of problems.

    The tensors of the problem are named to the solver, which leaves finished problems behind by
    selecting the rows of those that are still open; dynamics and weights are shared by all.
    """
    heading_of = problem.ego.heading_of

    def cost(states: Tensor, given: Tensor, *tensors: Tensor) -> Tensor:
        controls = coordinates.padded_controls(states, given)
        motion = dynamics.motion(states, controls)
        return planner.cost_of(motion, controls, joined(heading_of, tensors))

    return Batched(cost, *parted(problem))


def motion_cost(planner: HasPlanCost, problem: PlanningProblem) -> Batched:
    """Cost at each time of motions that are given, of a batch of problems.

    It is that of (rows `b t 6` of `motion_rows`, controls `b t m` in SI units).

    Args:
        planner: Whose cost it is.
        problem: The problems.
    """
    heading_of = problem.ego.heading_of

    def cost(rows: Tensor, controls: Tensor, *tensors: Tensor) -> Tensor:
        x, y, course, forward, left, yaw_rate = rows.unbind(-1)
        position, velocity = torch.stack([x, y], -1), torch.stack([forward, left], -1)
        moved = Motion(position, course, velocity, yaw_rate)
        return planner.cost_of(moved, controls, joined(heading_of, tensors))

    return Batched(cost, *parted(problem))


def motion_rows(motion: Motion) -> Float[Tensor, "*b t 6"]:
    """Motions as rows of numbers, for `motion_cost`."""
    position, course, velocity, yaw_rate = motion
    return torch.cat([position, course.unsqueeze(-1), velocity, yaw_rate.unsqueeze(-1)], -1)


def parted(problem: PlanningProblem) -> tuple[Tensor, ...]:
    """All tensors of a problem, in the order of `joined`."""
    ego = problem.ego
    own = (problem.goal, problem.reference, problem.reference_speed)
    return (*ego.motion, *ego.discs, *own, *problem.obstacles)


def joined(heading_of: HeadingOf, tensors: tuple[Tensor, ...]) -> PlanningProblem:
    """The problem of these tensors."""
    ego = Ego(Motion(*tensors[:4]), heading_of, Discs(*tensors[4:6]))
    goal, reference, speed = tensors[6:9]
    return PlanningProblem(ego, goal, reference, speed, Obstacles(*tensors[9:]))
