"""The learnable weighted sum of cost terms."""

import math
from collections.abc import Collection, Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.costs.base import CostTerm
from diffstack_mmv.types import Motion, PlanningProblem


class WeightedCost(nn.Module):
    """Σ_i w_i C_i with positive weights.

    The learned weights are W softmax(log w), W being the sum of their initial values: a scale on
    which the plan does not depend is not learned, and no weight leaves the positive numbers.
    Weights can be frozen one by one. Source: Karkus et al., DiffStack (CoRL 2022), normalised log
    parametrisation.

    Args:
        terms: The terms by name.
        weights: Initial weight of each, in 1 over the unit of the term.
        frozen: Names of the weights that are not learned.

    Raises:
        ValueError: Terms and weights have different names, a weight is not positive, or a frozen
            name is unknown.
    """

    def __init__(
        self,
        terms: Mapping[str, CostTerm],
        weights: Mapping[str, float],
        frozen: Collection[str] = (),
    ) -> None:
        super().__init__()
        require(
            set(terms) == set(weights),
            "weights",
            f"name the terms {sorted(terms)}",
            sorted(weights),
        )
        require(set(frozen) <= set(terms), "frozen", f"be among {sorted(terms)}", sorted(frozen))
        for name, weight in weights.items():
            require_positive(
                f"weights.{name}", weight, remedy="Leave the term out to switch it off."
            )
        self.terms = nn.ModuleDict(terms)
        self.learned = [name for name in terms if name not in frozen]
        self.fixed = {name: float(weights[name]) for name in terms if name in frozen}
        self.scale = math.fsum(weights[name] for name in self.learned)
        self.log_weight = nn.Parameter(
            torch.tensor([math.log(weights[name]) for name in self.learned])
        )

    @property
    def adds_components(self) -> bool:
        """Whether every term is a sum over the components of all agents, see `CostTerm`."""
        return all(getattr(term, "adds_components", False) for term in self.terms.values())

    def learnable(self) -> nn.Parameter:
        """Logarithms of the `learned` weights, one of each: what an optimiser may change."""
        return self.log_weight

    def weights(self) -> dict[str, Tensor | float]:
        """Present weight of every term."""
        if not self.learned:  # generated libraries know no softmax of nothing
            return dict(self.fixed)
        learned = self.scale * torch.softmax(self.log_weight, 0)
        return {**dict(zip(self.learned, learned.unbind(0), strict=True)), **self.fixed}

    def components(
        self,
        motion: Motion,
        controls: Float[Tensor, "*b t m"],
        problem: PlanningProblem,
        weights: Mapping[str, Tensor | float] | None = None,
    ) -> dict[str, Float[Tensor, "*b t"]]:
        """Weighted value of every term at each time.

        The present weights unless others are given.
        """
        used = self.weights() if weights is None else weights
        return {
            name: used[name] * term(motion, controls, problem) for name, term in self.terms.items()
        }

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Weighted sum at each time."""
        return torch.stack(list(self.components(motion, controls, problem).values())).sum(0)
