"""What a plan must keep to, as constraints of the optimiser instead of terms of its cost."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive, require_switch, require_whole
from diffstack_mmv.control import ILQR, Batched, Bounds, Solution
from diffstack_mmv.control.constrained import ConstrainedILQR, Inequality, Slack
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import clearance_lack
from diffstack_mmv.planning.coordinates import ControlCoordinates
from diffstack_mmv.planning.objective import joined, parted
from diffstack_mmv.types import GRAVITY, Motion, PlanningProblem

ABSENT = -1.0
"""Value of a limit for agents that are not there."""


@runtime_checkable
class PlanLimit(Protocol):
    """A quantity of a plan that must not be positive.

    One that depends on what is decided at a time, not on the state alone, says `of_control = True`.
    """

    def __call__(
        self, motion: Motion, acceleration: Float[Tensor, "*b t"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t k"]:
        """Values at each time; entry t depends on motion and control at t alone.

        Args:
            motion: The plan.
            acceleration: Commanded, in m/s²; zero for a model without such a control.
            problem: Its leading dimensions are those of the motion without time.
        """
        ...


@dataclass(frozen=True)
class SpeedWithin:
    """v - v_ref - excess ≤ 0, in m/s.

    Args:
        excess_mps: How far the reference speed may be exceeded, in m/s.
    """

    of_control: ClassVar[bool] = False
    excess_mps: float = 0.0

    def __call__(
        self, motion: Motion, acceleration: Float[Tensor, "*b t"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t one"]:
        """Value in m/s."""
        most = problem.reference_speed.unsqueeze(-1) + self.excess_mps
        return (motion.velocity[..., 0] - most).unsqueeze(-1)


@dataclass(frozen=True)
class FrictionCircle:
    """(a² + (v r)²) / (μ g)² - 1 ≤ 0, dimensionless: all tyres together within their grip.

    Args:
        friction: μ.

    Raises:
        ValueError: The friction is not positive.
    """

    of_control: ClassVar[bool] = True
    friction: float = 0.8

    def __post_init__(self) -> None:
        require_positive("friction", self.friction)

    def __call__(
        self, motion: Motion, acceleration: Float[Tensor, "*b t"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t one"]:
        """Value, -1 without any force."""
        lateral = motion.velocity[..., 0] * motion.yaw_rate
        grip = (self.friction * GRAVITY) ** 2
        return ((acceleration.square() + lateral.square()) / grip - 1).unsqueeze(-1)


@dataclass(frozen=True)
class ClearanceKept:
    """r_ego + r_i + margin - d_ikt ≤ 0, in m, for every agent i and component k.

    d is the distance of the agent to the axis of the vehicle between its first and its last disc.

    Args:
        margin_m: Clearance that is kept, in m.

    Raises:
        ValueError: The margin is negative.
    """

    of_control: ClassVar[bool] = False
    margin_m: float = 0.2

    def __post_init__(self) -> None:
        require_at_least("margin_m", self.margin_m, 0.0)

    def __call__(
        self, motion: Motion, acceleration: Float[Tensor, "*b t"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t k"]:
        """Value in m."""
        obstacles = problem.obstacles
        lack = clearance_lack(motion, problem.ego.discs, obstacles, self.margin_m)
        lack = torch.where(obstacles.valid[..., None, None], lack, torch.full_like(lack, ABSENT))
        return lack.flatten(-3, -2).movedim(-1, -2)


@dataclass(frozen=True)
class PlanConstraints:
    """Limits of all plans, which the optimiser keeps to from the first step on.

    Those of the control hold for the first one as well, but for models whose yaw rate is a state.

    Args:
        limits: By name; without any the optimiser is as it is.
        linear: Price of a violation per unit of a limit; infinite: there must be none.
        max_iterations: Limit of iterations of each phase of the constrained solver.
        tolerance: Largest violation of a hard limit.
        persistent: See `ConstrainedILQR`; a decision in time is worth more than one solution more.

    Raises:
        ValueError: The price is negative, the tolerance not positive, or there is no iteration.
    """

    limits: Mapping[str, PlanLimit]
    linear: float = float("inf")
    max_iterations: int = 40
    tolerance: float = 1e-3
    persistent: bool = False

    def __post_init__(self) -> None:
        require_at_least("linear", self.linear, 0)
        require_whole("max_iterations", self.max_iterations)
        require_at_least("max_iterations", self.max_iterations, 1)
        require_positive("tolerance", self.tolerance)
        require_switch("persistent", self.persistent)

    def solve(
        self,
        solver: ILQR,
        dynamics: DynamicsModel,
        coordinates: ControlCoordinates,
        problem: PlanningProblem,
        cost: Cost,
        guess: Float[Tensor, "B T m"],
        state: Float[Tensor, "B n"],
    ) -> Solution:
        """Solve problems with one leading dimension under the limits.

        A problem whose limits cannot be met has the status INFEASIBLE once no step lowers the
        violation, or ITERATION_LIMIT where one still does.

        Args:
            solver: Which keeps to nothing but a box.
            dynamics: The model.
            coordinates: In which the optimiser sees its controls; the limits see those in SI units.
            problem: The problems.
            cost: Of states and coordinates.
            guess: Coordinates to start from, `B T m`.
            state: Where the plans begin, `B n`.

        Returns:
            The solution, with coordinates as its controls.
        """
        constraints = [
            self._constraint(each, dynamics, coordinates, problem) for each in self.limits.values()
        ]
        constrained = ConstrainedILQR(solver, self.max_iterations, self.tolerance, self.persistent)
        step: Dynamics = Batched(coordinates.step)
        box: Bounds = coordinates.bounds
        return constrained(step, cost, constraints, box, state, guess).solution

    def _constraint(
        self,
        limit: PlanLimit,
        dynamics: DynamicsModel,
        coordinates: ControlCoordinates,
        problem: PlanningProblem,
    ) -> Inequality:
        heading_of, column = problem.ego.heading_of, _acceleration_column(dynamics)

        def values(states: Tensor, given: Tensor, *tensors: Tensor) -> Tensor:
            controls = coordinates.padded_controls(states, given)
            motion = dynamics.motion(states, controls)
            command = controls[..., column] if column is not None else 0 * controls[..., 0]
            return limit(motion, command, joined(heading_of, tensors))

        # the present state is as it is, and so is a yaw rate that is part of it
        decided = getattr(limit, "of_control", False) and "yaw_rate" not in dynamics.State._fields
        times = slice(None) if decided else slice(1, None)
        return Inequality(Batched(values, *parted(problem)), Slack(self.linear), times)


def _acceleration_column(dynamics: DynamicsModel) -> int | None:
    fields = dynamics.Control._fields
    return fields.index("acceleration") if "acceleration" in fields else None
