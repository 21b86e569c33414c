"""Combinations of parameters that tracks inform where they do not inform the single ones."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.func import functional_call, jacfwd

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.inference.optima import LocalOptimum, mixture_variance
from diffstack_mmv.identification.inference.sensitivity import (
    Identifiability,
    IdentifiabilityThresholds,
    owed_to_priors,
)
from diffstack_mmv.identification.shooting.parameters import ParameterVector


class Combination(NamedTuple):
    """A quantity that depends on several parameters, with its standard deviations."""

    name: str
    unit: str
    initial: float
    estimate: float
    std: float
    prior_std: float
    verdict: Identifiability


class _Quantities(nn.Module):
    """The combinations of a model as a function of its parameters."""

    def __init__(self, model: DynamicsModel) -> None:
        super().__init__()
        self.model = model

    def forward(self) -> Float[Tensor, " q"]:
        values = [each.value for each in self.model.derived_quantities().values()]
        return torch.stack(values) if values else self.model.bounds.lower[:0]


def quantities(model: DynamicsModel) -> Float[Tensor, " q"]:
    """The combinations at the present parameters of a model."""
    with torch.no_grad():
        return _Quantities(model)()


@torch.no_grad()
def combinations(
    model: DynamicsModel,
    parameters: ParameterVector,
    optima: Sequence[LocalOptimum],
    thresholds: IdentifiabilityThresholds,
) -> list[Combination]:
    """The derived quantities of a model with their standard deviations and verdicts.

    Standard deviations by the delta method, widened by what other optima say.

    Args:
        model: The dynamics.
        parameters: Its learned numbers.
        optima: The estimate, then others that explain the tracks.
        thresholds: When a quantity counts as informed.
    """
    combined = _Quantities(model)

    def quantities_of(theta: Tensor) -> Tensor:
        return functional_call(combined, parameters.tensors(theta, "model."), ())

    def variance_of(theta: Tensor, covariance: Tensor) -> Tensor:
        rows = jacfwd(quantities_of)(theta) / parameters.slope(theta)
        return (rows @ covariance * rows).sum(-1)

    start = torch.zeros_like(optima[0].fit.theta)
    prior_variance = variance_of(start, parameters.prior.std.square().diag())
    found = optima[0].sensitivity
    all_values = torch.stack([quantities_of(each.fit.theta) for each in optima])
    variances = torch.stack(
        [variance_of(each.fit.theta, each.sensitivity.covariance) for each in optima]
    )
    estimate, initial = all_values[0], quantities_of(start)
    variance = torch.maximum(mixture_variance(optima, all_values, variances), variances[0])
    owed = owed_to_priors(variances[0], variance_of(optima[0].fit.theta, found.of_noise))
    found_rows = []
    units = {name: each.unit for name, each in model.derived_quantities().items()}
    for index, (name, unit) in enumerate(units.items()):
        std, prior_std = float(variance[index].sqrt()), float(prior_variance[index].sqrt())
        value = float(estimate[index])
        ratio = std / prior_std if prior_std > 0 else 1.0
        verdict = thresholds.classify(
            ratio, std / abs(value) if value else math.inf, found.noise_factor, float(owed[index])
        )
        numbers = (float(initial[index]), value, std, prior_std)
        found_rows.append(Combination(name, unit, *numbers, verdict))
    return found_rows
