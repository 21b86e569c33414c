"""What tracks say about physical parameters, with the unknowns of the tracks marginalised.

All in physical units: with S_v the Schur complement of the Gauss-Newton Hessian (the Fisher
information of the positions about the values v) and P the precision of the priors, the posterior
covariance is Σ = (S_v + P)⁻¹. A parameter is judged by two ratios of its posterior to its prior
standard deviation: marginal (all others unknown) and conditional (all others known). The posterior
may be narrow for priors of *other* parameters; so it is divided into

    Σ = Σ S_v Σ + Σ P Σ

what the noise of the tracks does to the estimates, and what errors of the priors do. What owes most
of its variance to priors is known as far as the other parameters are: only in combination.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between, require_positive
from diffstack_mmv.identification.shooting.block_arrowhead import BlockArrowhead, eliminate_tracks
from diffstack_mmv.identification.shooting.parameters import ParameterVector


class Identifiability(StrEnum):
    """What the data say about one parameter.

    Identifiable: its posterior is narrow and precise. Weakly identifiable: its posterior is
    narrower than its prior. Only in combination: it would be identifiable if the others were known,
    and what is left unknown of it is the error of their priors.
    """

    IDENTIFIABLE = "identifiable"
    WEAK = "weakly identifiable"
    COMBINED = "only in combination"
    NOT_IDENTIFIABLE = "not identifiable"


@dataclass(frozen=True)
class IdentifiabilityThresholds:
    """When a parameter counts as informed by the data.

    Args:
        identifiable: Largest ratio of marginal posterior to prior standard deviation.
        informed: Largest ratio of conditional posterior to prior standard deviation; a parameter
            above it stays at its prior.
        precise: Largest standard deviation relative to the value of an identifiable quantity; one
            that the tracks inform less precisely is weakly identifiable.
        owed: Largest share of the variance of an identifiable quantity that errors of priors cause;
            above it, it is known in combination with others alone.
        misfit: Largest ratio of residuals to assumed noise of a trusted fit; above it nothing
            is called identifiable.

    Raises:
        ValueError: A ratio or share is not between 0 and 1, `precise` is not positive, or `misfit`
            is below 1.
    """

    identifiable: float = 0.4
    informed: float = 0.8
    precise: float = 0.015
    owed: float = 0.5
    misfit: float = 1.25

    def __post_init__(self) -> None:
        require_between("identifiable", self.identifiable, 0.0, 1.0)
        require_between("informed", self.informed, self.identifiable, 1.0)
        require_positive("precise", self.precise)
        require_between("owed", self.owed, 0.0, 1.0)
        require_at_least("misfit", self.misfit, 1.0)

    def classify(
        self, marginal: float, relative_std: float, noise_factor: float = 1.0, owed: float = 0.0
    ) -> Identifiability:
        """Identifiability of a quantity.

        Args:
            marginal: Posterior over prior standard deviation.
            relative_std: Posterior standard deviation over value.
            noise_factor: Residuals over assumed noise.
            owed: Share of the posterior variance that errors of priors cause.
        """
        if marginal > self.identifiable:
            return Identifiability.NOT_IDENTIFIABLE
        if owed > self.owed:
            return Identifiability.COMBINED
        sure = relative_std <= self.precise and noise_factor <= self.misfit
        return Identifiability.IDENTIFIABLE if sure else Identifiability.WEAK


class InformationDirection(NamedTuple):
    """A direction in the space of the values, each in units of its prior standard deviation."""

    eigenvalue: float  # information, in units of that of the prior
    weights: tuple[float, ...]


class Sensitivity(NamedTuple):
    """Information of tracks about the learned parameters."""

    information: Float[Tensor, "p p"]  # S_v, of the data alone
    covariance: Float[Tensor, "p p"]  # posterior
    of_noise: Float[Tensor, "p p"]  # the part of it that noise causes; the rest is of priors
    std: Float[Tensor, " p"]
    marginal_ratio: Float[Tensor, " p"]
    conditional_ratio: Float[Tensor, " p"]
    directions: tuple[InformationDirection, ...]  # from the best to the least informed one
    noise_factor: float  # residuals over assumed noise, at least 1

    def widened(self, std: Float[Tensor, " p"]) -> "Sensitivity":
        """The same with deviations that are at least these, up to those of the priors.

        Correlations stay, and what is added counts as caused by noise.
        """
        prior = self.std / self.marginal_ratio
        factor = torch.minimum(torch.maximum(std, self.std), prior).clamp_min(self.std) / self.std
        covariance = self.covariance * factor * factor.unsqueeze(-1)
        return self._replace(
            covariance=covariance,
            of_noise=covariance - (self.covariance - self.of_noise),
            std=self.std * factor,
            marginal_ratio=self.marginal_ratio * factor,
        )

    def classify(
        self, values: Float[Tensor, " p"], thresholds: IdentifiabilityThresholds
    ) -> list[Identifiability]:
        """Identifiability of each parameter, given the estimates."""
        relative = (self.std / values.abs()).tolist()
        owed = owed_to_priors(self.covariance.diagonal(), self.of_noise.diagonal()).tolist()
        found = []
        for index, marginal in enumerate(self.marginal_ratio.tolist()):
            verdict = thresholds.classify(marginal, relative[index], self.noise_factor, owed[index])
            conditional = float(self.conditional_ratio[index])
            if verdict is Identifiability.NOT_IDENTIFIABLE and conditional <= thresholds.informed:
                alone = conditional <= thresholds.identifiable
                verdict = Identifiability.COMBINED if alone else Identifiability.WEAK
            found.append(verdict)
        return found


def sensitivity(
    system: BlockArrowhead,
    parameters: ParameterVector,
    theta: Float[Tensor, " p"],
    noise_factor: float = 1.0,
    active: Bool[Tensor, " p"] | None = None,
) -> Sensitivity:
    """Information about the values at θ.

    Args:
        system: Normal equations of the tracks at the solution, without priors.
        parameters: The learned parameters.
        theta: θ.
        noise_factor: True standard deviation of the residuals over the assumed one.
        active: Which values were fitted, all by default. The others keep the error of their prior,
            which propagates to those that were fitted.
    """
    slope = parameters.slope(theta)
    information = (
        eliminate_tracks(system).information / (slope * slope.unsqueeze(-1)) / noise_factor**2
    )
    precision = parameters.prior.std**-2
    fitted = torch.ones_like(precision) > 0 if active is None else active
    covariance, of_noise = _covariance(information, precision, fitted)
    std = covariance.diagonal().sqrt()
    conditional = (information.diagonal().clamp_min(0) + precision).rsqrt()
    scale = parameters.prior.std
    values, vectors = torch.linalg.eigh(information * scale * scale.unsqueeze(-1))
    directions = tuple(
        InformationDirection(max(float(value), 0.0), tuple(vector.tolist()))
        for value, vector in zip(values.flip(0), vectors.mT.flip(0), strict=True)
    )
    return Sensitivity(
        information,
        covariance,
        of_noise,
        std,
        std / scale,
        conditional / scale,
        directions,
        noise_factor,
    )


def owed_to_priors(
    variance: Float[Tensor, " q"], of_noise: Float[Tensor, " q"]
) -> Float[Tensor, " q"]:
    """Share of variances that errors of priors cause.

    Args:
        variance: Of some quantities.
        of_noise: The part that noise causes.
    """
    share = 1 - of_noise / variance
    # a quantity that no parameter moves has no variance
    return torch.where(variance > 0, share, 1.0).clamp(0.0, 1.0)


def _covariance(
    information: Float[Tensor, "p p"],
    precision: Float[Tensor, " p"],
    active: Bool[Tensor, " p"],
) -> tuple[Float[Tensor, "p p"], Float[Tensor, "p p"]]:
    """Covariance of the errors when only the active values are estimated, the others assumed.

    With A = (S_aa + P_a)⁻¹ and the gain G = [-A S_ab; 1] on the errors of the assumed values b, it
    is A on the active block plus G P_b⁻¹ Gᵀ (Schmidt's consider covariance). Noise causes
    A S_aa A of it, the second result.
    """
    covariance, of_noise = torch.zeros_like(information), torch.zeros_like(information)
    block = information[active][:, active] + precision[active].diag()
    inverse = torch.linalg.inv(block)
    gain = torch.eye(len(precision), dtype=information.dtype)[:, ~active]
    gain[active] = -inverse @ information[active][:, ~active]
    both = active.unsqueeze(-1) & active
    covariance[both] = inverse.flatten()
    of_noise[both] = (inverse - (inverse * precision[active]) @ inverse).flatten()
    return covariance + (gain / precision[~active]) @ gain.mT, of_noise


def describe_direction(
    direction: InformationDirection, names: Sequence[str], share: float = 0.2
) -> str:
    """A direction in words: its largest parameters with their weights."""
    order = sorted(range(len(names)), key=lambda index: -abs(direction.weights[index]))
    largest = abs(direction.weights[order[0]]) if order else 0.0
    sign = 1.0 if not order or direction.weights[order[0]] >= 0 else -1.0
    parts = [
        f"{sign * direction.weights[index]:+.2f} {names[index]}"
        for index in order
        if abs(direction.weights[index]) >= share * largest
    ]
    return ", ".join(parts)
