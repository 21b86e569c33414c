"""Which plan is driven in the end: the optimum, or the cheapest safe one of all."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.planning.pricing import ScoredPlans
from diffstack_mmv.types import Motion, PlanOrigin, Solution, map_tensors

Scored = Callable[[Tensor, Motion], ScoredPlans]


class ChosenPlan(NamedTuple):
    """One plan of each problem."""

    controls: Float[Tensor, "*b T m"]
    motion: Motion  # *b T+1
    origin: Int[Tensor, "*b"]  # a PlanOrigin


@runtime_checkable
class PlanChoice(Protocol):
    """Chooses among the proposals and the solutions that were started from some of them."""

    def __call__(
        self,
        proposals: ScoredPlans,
        fan_size: int,
        solution: Solution,
        motion: Motion,
        scored: Scored,
    ) -> ChosenPlan:
        """Choose.

        Args:
            proposals: The fan, then the previous plan where there is one, `*b C`.
            fan_size: Number of plans in the fan.
            solution: The solutions, `*b k`.
            motion: Their motions, `*b k T1`.
            scored: Scores plans (controls, motion) like the proposals.

        Returns:
            The chosen plans.
        """
        ...


@dataclass(frozen=True)
class TakeOptimum:
    """The solution with the least cost, with its gradient."""

    def __call__(
        self,
        proposals: ScoredPlans,
        fan_size: int,
        solution: Solution,
        motion: Motion,
        scored: Scored,
    ) -> ChosenPlan:
        """Choose; see `PlanChoice`.

        Raises:
            ValueError: The optimiser was not started.
        """
        starts = solution.cost.shape[-1]
        require_at_least("starts", starts, 1, "where the optimum is taken")
        best = solution.cost.argmin(-1)
        origin = torch.full_like(best, PlanOrigin.OPTIMISED)
        return ChosenPlan(*_taken(solution.controls, motion, best), origin)


@dataclass(frozen=True)
class CheapestSafe:
    """The cheapest safe plan among proposals and solutions.

    Where nothing is safe, the plan that lacks the least clearance; where no plan is finite, as
    after a divergence of the model, the last of the fan, which `DetourFan` makes maximal braking.
    """

    def __call__(
        self,
        proposals: ScoredPlans,
        fan_size: int,
        solution: Solution,
        motion: Motion,
        scored: Scored,
    ) -> ChosenPlan:
        """Choose; see `PlanChoice`."""
        proposed = proposals.cost.shape[-1]
        plans = proposals.beside(scored(solution.controls, motion))
        nothing = plans.cost.isinf().all(-1)
        best = torch.where(nothing, fan_size - 1, plans.best())
        origin = torch.full_like(best, PlanOrigin.PREVIOUS)
        origin = torch.where(best < fan_size, PlanOrigin.CANDIDATE, origin)
        origin = torch.where(best >= proposed, PlanOrigin.OPTIMISED, origin)
        origin = torch.where(plans.safe.any(-1), origin, PlanOrigin.FALLBACK)
        return ChosenPlan(*_taken(plans.controls, plans.motion, best), origin)


def _taken(
    controls: Float[Tensor, "*b C T m"], motion: Motion, index: Int[Tensor, "*b"]
) -> tuple[Tensor, Motion]:
    """The plans with these numbers."""
    plans = index.dim()

    def take(entry: Tensor) -> Tensor:
        place = index.reshape(*index.shape, *(1 for _ in entry.shape[plans:]))
        return entry.take_along_dim(place, plans).squeeze(plans)

    return take(controls), map_tensors(take, motion)
