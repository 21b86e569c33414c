"""Which plan is driven in the end: the optimum, or the cheapest safe one of all."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.planning.pricing import Plans, PlanScore, ScoredPlans, Situation
from diffstack_mmv.types import Motion, PlanOrigin, Solution, map_tensors, taken


class ChosenPlan(NamedTuple):
    """One plan of each problem."""

    controls: Float[Tensor, "*b T m"]
    motion: Motion  # *b T+1
    origin: Int[Tensor, "*b"]  # a PlanOrigin


class Options(NamedTuple):
    """Among which plans the choice is."""

    proposals: ScoredPlans  # *b C: the fan, then the previous plan where there is one
    fan_size: int  # plans in the fan
    solution: Solution  # *b k, started from some of the proposals
    solved: Plans  # of the solutions


@runtime_checkable
class PlanChoice(Protocol):
    """Chooses among the proposals and the solutions that were started from some of them."""

    def __call__(self, options: Options, score: PlanScore, situation: Situation) -> ChosenPlan:
        """Choose.

        Args:
            options: Proposals, scored already, and solutions.
            score: By which the proposals were scored.
            situation: In which they were.

        Returns:
            The chosen plans.
        """
        ...


@dataclass(frozen=True)
class TakeOptimum:
    """The solution with the least cost, with its gradient."""

    def __call__(self, options: Options, score: PlanScore, situation: Situation) -> ChosenPlan:
        """Choose; see `PlanChoice`.

        Raises:
            ValueError: The optimiser was not started.
        """
        cost = options.solution.cost
        require_at_least("starts", cost.shape[-1], 1, "where the optimum is taken")
        best = cost.argmin(-1)
        origin = torch.full_like(best, PlanOrigin.OPTIMISED)
        return ChosenPlan(*_taken(options.solved, best), origin)


@dataclass(frozen=True)
class CheapestSafe:
    """The cheapest safe plan among proposals and solutions.

    Where nothing is safe, the plan that lacks the least clearance; where no plan is finite, as
    after a divergence of the model, the last of the fan, which `DetourFan` makes maximal braking.
    """

    def __call__(self, options: Options, score: PlanScore, situation: Situation) -> ChosenPlan:
        """Choose; see `PlanChoice`."""
        proposals, fan_size = options.proposals, options.fan_size
        scored = proposals.beside(score(options.solved, situation))
        nothing = scored.cost.isinf().all(-1)
        best = torch.where(nothing, fan_size - 1, scored.best())
        origin = torch.full_like(best, PlanOrigin.PREVIOUS)
        origin = torch.where(best < fan_size, PlanOrigin.CANDIDATE, origin)
        origin = torch.where(best >= proposals.cost.shape[-1], PlanOrigin.OPTIMISED, origin)
        origin = torch.where(scored.safe.any(-1), origin, PlanOrigin.FALLBACK)
        return ChosenPlan(*_taken(scored.plans, best), origin)


def _taken(plans: Plans, index: Int[Tensor, "*b"]) -> Plans:
    """The plans with these numbers, without the dimension `C`."""
    chosen = taken(plans, index.unsqueeze(-1))
    return map_tensors(lambda entry: entry.squeeze(index.dim()), chosen)
