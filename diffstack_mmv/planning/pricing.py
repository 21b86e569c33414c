"""What candidate plans are worth: their cost alone, or their price among agents."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive, require_switch
from diffstack_mmv.planning.clearance import ClearanceMargin, clearance_within_steps
from diffstack_mmv.planning.judgement import Passing, judged
from diffstack_mmv.types import Motion, PlanningProblem, map_tensors


class Plans(NamedTuple):
    """Plans of each problem."""

    controls: Float[Tensor, "*b C T m"]  # SI units
    motion: Motion  # *b C T+1

    def beside(self, more: "Plans") -> "Plans":
        """These plans, then the others."""
        return _beside(self, more, self.motion.heading.dim() - 2)


class Situation(NamedTuple):
    """In which plans are scored."""

    problem: PlanningProblem  # *b
    cost: Callable[[Motion, Tensor], Tensor]
    """(motion `*b C T1`, controls `*b C T m`) -> the planner's cost at each time, `*b C T1`."""
    waited: Float[Tensor, "*b"]  # s in which the vehicle came no closer to its goal
    dt_s: float  # between two rows of a plan


class ScoredPlans(NamedTuple):
    """Plans with what they are worth."""

    plans: Plans
    cost: Float[Tensor, "*b C"]  # infinite where a plan is not usable
    safe: Bool[Tensor, "*b C"]
    shortfall: Float[Tensor, "*b C"]  # m, lack of clearance

    def beside(self, more: "ScoredPlans") -> "ScoredPlans":
        """These plans, then the others."""
        return _beside(self, more, self.cost.dim() - 1)

    def best(self) -> Int[Tensor, "*b"]:
        """The cheapest safe plan; where none is safe, the one that lacks the least clearance."""
        cheapest = torch.where(self.safe, self.cost, torch.inf).argmin(-1)
        least = (self.shortfall + 1e-6 * self.cost.clamp(max=1e4)).argmin(-1)
        return torch.where(self.safe.any(-1), cheapest, least)


@runtime_checkable
class PlanScore(Protocol):
    """Says what plans are worth, from the planner's cost along them.

    `differentiable` tells whether the score carries gradients to the cost weights; one that does
    not is computed without.
    """

    differentiable: bool

    def __call__(self, plans: Plans, situation: Situation) -> ScoredPlans:
        """Score plans in a situation."""
        ...


@dataclass(frozen=True)
class CostScore:
    """The planner's cost alone, summed over the plan; every plan with a finite cost is safe."""

    differentiable = True

    def __call__(self, plans: Plans, situation: Situation) -> ScoredPlans:
        """Score plans; see `PlanScore`."""
        total = situation.cost(plans.motion, plans.controls).sum(-1)
        usable = total.isfinite()
        cost = torch.where(usable, total, torch.inf)
        return ScoredPlans(plans, cost, usable, torch.zeros_like(total))


@dataclass(frozen=True)
class PlanPrice:
    """The planner's cost up to the arrival, time, lack of comfortable clearance, and impatience.

        S = Σ_t [t ≤ arrival] (c_t + w_time dt) + w_risk R + q w_comfort P
            + (1 - q) w_left [T < arrival] ‖p_T - g‖

    with R and P of `ClearanceMargin` and the patience q in (0, 1] of a vehicle that gets no closer
    to its goal: comfort then counts less and getting ahead more. The safe clearance is asked for
    ever, and the risk R keeps the vehicle away from where many may come later than plans are
    refused for. A price ranks plans and carries no gradient.

    Attributes:
        margin: Clearance asked of a plan.
        comfort_weight: Price of the lack of comfortable clearance in 1/(m² s).
        risk_weight: Price of a second of expected contact at any time of the plan in 1/s.
        time_weight: Price of a second before the arrival in 1/s.
        left_weight: Price of a metre left to the goal at the horizon, without patience, in 1/m.
        patience_s: Time without progress in which patience halves.
        goal_tolerance_m: A plan has arrived where it is closer than this to the goal.
        compile: Judge clearances in a library, on a CPU with a compiler.

    Raises:
        ValueError: A weight is negative, or a time or tolerance not positive.
    """

    margin: ClearanceMargin = field(default_factory=ClearanceMargin)
    comfort_weight: float = 300.0
    risk_weight: float = 0.0
    time_weight: float = 2.0
    left_weight: float = 10.0
    patience_s: float = 1.0
    goal_tolerance_m: float = 0.25
    compile: bool = False

    differentiable = False

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("comfort_weight", "risk_weight", "time_weight", "left_weight"):
            require_at_least(name, getattr(self, name), 0)
        require_positive("patience_s", self.patience_s)
        require_positive("goal_tolerance_m", self.goal_tolerance_m)
        require_switch("compile", self.compile)

    @torch.no_grad()
    def __call__(self, plans: Plans, situation: Situation) -> ScoredPlans:
        """Price plans; see `PlanScore`."""
        motion, (problem, cost, waited, dt_s) = plans.motion, situation
        running = cost(motion, plans.controls) + self.time_weight * dt_s
        way = (motion.position - problem.goal[..., None, None, :]).square().sum(-1).sqrt()
        arrived = (way < self.goal_tolerance_m).long()
        under_way = (arrived.cumsum(-1) - arrived) == 0
        # a step belongs to the way if it begins before the arrival
        driven = (arrived.cumsum(-1) == 0)[..., :-1]
        safety, risk = self._judged(motion, problem, driven, dt_s)
        patience = 0.5 ** (waited.unsqueeze(-1) / self.patience_s)
        total = (running * under_way).sum(-1) + patience * self.comfort_weight * safety.penalty
        total = total + self.risk_weight * risk
        # whoever has arrived stops there, whatever the rest of the plan does
        left = torch.where(arrived.any(-1), 0, way[..., -1])
        total = total + (1 - patience) * self.left_weight * left
        usable = total.isfinite()
        return ScoredPlans(
            plans=plans,
            cost=torch.where(usable, total, torch.inf),
            safe=safety.safe & usable,
            shortfall=torch.where(usable, safety.shortfall, torch.inf),
        )

    def _judged(
        self,
        motion: Motion,
        problem: PlanningProblem,
        driven: Bool[Tensor, "*b C T"],
        dt_s: float,
    ) -> Passing:
        """How the plans pass the agents until they arrive."""
        margin, discs, obstacles = self.margin, problem.ego.discs, problem.obstacles
        if self.compile:
            found = judged(margin, motion, discs, obstacles, driven, dt_s)
            if found is not None:
                return found
        clearance = clearance_within_steps(motion, discs, obstacles)
        clearance = torch.where(driven[..., None, None, :], clearance, torch.inf)
        safety = margin(clearance, obstacles, dt_s)
        none = torch.zeros_like(safety.penalty)
        return Passing(
            safety, margin.risk(clearance, obstacles, dt_s) if self.risk_weight > 0 else none
        )


def _beside(plans: Any, more: Any, dim: int) -> Any:
    """The tensors of a record, then those of the other, along a dimension."""
    return map_tensors(lambda *entries: torch.cat(entries, dim), plans, more)
