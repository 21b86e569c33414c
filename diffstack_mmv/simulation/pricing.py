"""What a plan among people costs, and whether it is safe."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.planning import MPCPlanner, with_final_row
from diffstack_mmv.simulation.safety import Safety, SafetyMargin, clearance_of
from diffstack_mmv.types import Motion, PlanningProblem, map_tensors


class PricedPlans(NamedTuple):
    """Plans with their price."""

    controls: Float[Tensor, "b C T m"]
    position: Float[Tensor, "b C T1 2"]  # m
    cost: Float[Tensor, "b C"]  # infinite where a plan is not finite
    safe: Bool[Tensor, "b C"]
    shortfall: Float[Tensor, "b C"]  # m, lack of clearance

    def beside(self, others: "PricedPlans") -> "PricedPlans":
        """These plans, then the others."""
        pairs = zip(self, others, strict=True)
        return PricedPlans(*(torch.cat(pair, 1) for pair in pairs))

    def best(self) -> Int[Tensor, " b"]:
        """The cheapest safe plan; where none is safe, the one that lacks the least clearance."""
        cheapest = torch.where(self.safe, self.cost, torch.inf).argmin(-1)
        least = (self.shortfall + 1e-6 * self.cost.clamp(max=1e4)).argmin(-1)
        return torch.where(self.safe.any(-1), cheapest, least)


@dataclass(frozen=True)
class PlanPrice:
    """The planner's cost up to the arrival, time, lack of comfortable clearance, and impatience.

        S = Σ_t [t ≤ arrival] (c_t + w_time dt) + q w_comfort P + (1 - q) w_left ‖p_T - g‖

    with P of `SafetyMargin` and the patience q in (0, 1] of a vehicle that gets no closer to its
    goal: comfort then counts less and getting ahead more. The safe clearance is asked for ever.

    Attributes:
        margin: Clearance asked of a plan.
        comfort_weight: Price of the lack of comfortable clearance in 1/(m² s).
        time_weight: Price of a second before the arrival in 1/s.
        left_weight: Price of a metre left to the goal at the horizon, without patience, in 1/m.
        patience_s: Time without progress in which patience halves.
        goal_tolerance_m: A plan has arrived where it is closer than this to the goal.

    Raises:
        ValueError: A weight is negative, or a time or tolerance not positive.
    """

    margin: SafetyMargin = field(default_factory=SafetyMargin)
    comfort_weight: float = 300.0
    time_weight: float = 2.0
    left_weight: float = 10.0
    patience_s: float = 1.0
    goal_tolerance_m: float = 0.25

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("comfort_weight", "time_weight", "left_weight"):
            require_at_least(name, getattr(self, name), 0)
        require_positive("patience_s", self.patience_s)
        require_positive("goal_tolerance_m", self.goal_tolerance_m)

    def __call__(
        self,
        planner: MPCPlanner,
        problem: PlanningProblem,
        controls: Float[Tensor, "b C T m"],
        motion: Motion,
        waited: Float[Tensor, " b"],
    ) -> PricedPlans:
        """Price plans.

        Args:
            planner: Its cost and its model.
            problem: The problems, `b`.
            controls: Controls of the plans, SI units.
            motion: Their motions, `b C T1`.
            waited: How long each vehicle has come no closer to its goal, s.

        Returns:
            The plans with their price.
        """
        dt_s = planner.dynamics.dt_s
        per_plan = map_tensors(lambda field: field.unsqueeze(1), problem)
        running = planner.cost_of(motion, with_final_row(controls), per_plan)
        running = running + self.time_weight * dt_s
        way = (motion.position - per_plan.goal.unsqueeze(-2)).square().sum(-1).sqrt()
        arrived = (way < self.goal_tolerance_m).long()
        under_way = (arrived.cumsum(-1) - arrived) == 0
        safety = self._safety(problem, motion, under_way, dt_s)
        patience = 0.5 ** (waited[:, None] / self.patience_s)
        total = (running * under_way).sum(-1) + patience * self.comfort_weight * safety.penalty
        total = total + (1 - patience) * self.left_weight * way[..., -1]
        usable = total.isfinite()
        return PricedPlans(
            controls=controls,
            position=motion.position,
            cost=torch.where(usable, total, torch.inf),
            safe=safety.safe & usable,
            shortfall=torch.where(usable, safety.shortfall, torch.inf),
        )

    def _safety(
        self,
        problem: PlanningProblem,
        motion: Motion,
        under_way: Bool[Tensor, "b C T1"],
        dt_s: float,
    ) -> Safety:
        """Judge the clearance to the predicted people in the steps before the arrival."""
        reach = problem.radius[..., None] + problem.obstacles.radius
        people = problem.obstacles.position.squeeze(-3)
        clearance = clearance_of(motion.position, people, reach)
        clearance = torch.where(under_way[..., None, :-1], clearance, torch.inf)
        walked = people.diff(dim=-2).square().sum(-1).sqrt().cumsum(-1)
        return self.margin(clearance, walked.unsqueeze(-3), dt_s)
