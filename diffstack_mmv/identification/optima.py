"""Optima of a fit: what each says, how much of the posterior lies there, and what all say together.

Tyres act on a path mostly by their cornering stiffness 2 c_p ℓ², so a stiff short contact and a
soft long one may explain tracks equally well: the posterior has several summits. A single fit,
however good, knows the width of the summit that it stands on. Fits from starts all over the prior
find the others, and with the posterior mass w_k of each by Laplace's approximation

    ln w_k = -J_k - ½ Σ ln|H_i| + ½ ln|Σ_k| + const,    σ² = Σ w_k (σ_k² + (v_k - v)²)

is the mean square error of the best estimate v.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.identification.fit import Fit, total_cost
from diffstack_mmv.identification.linearisation import Tracker, normal_equations
from diffstack_mmv.identification.parameters import LearnedParameters
from diffstack_mmv.identification.problem import Problem
from diffstack_mmv.identification.sensitivity import Sensitivity, sensitivity

SCATTER = 1.9  # prior deviations: the range ends at two
APART = 0.5  # standard deviations between two optima that are not the same


class Optimum(NamedTuple):
    """A fit, and what it says."""

    fit: Fit
    sensitivity: Sensitivity
    noise_factor: float  # deviation of the residuals over the assumed one
    cost: float  # of the tracks and the prior
    log_volume: float  # of the summit, up to a constant


def optimum(
    tracker: Tracker, problem: Problem, fit: Fit, active: Bool[Tensor, " p"] | None = None
) -> Optimum:
    """What the tracks say at a fit; noise above the assumed one lessens it.

    Args:
        tracker: Model and residuals.
        problem: The fitted tracks.
        fit: The fit, tracks in one piece.
        active: Which values were fitted, all by default.
    """
    unknowns, simulated, _ = fit.fitted
    jacobian = tracker.jacobian(fit.theta, problem, unknowns, simulated)
    arrow = normal_equations(jacobian, simulated.residual, unknowns)
    factor = torch.linalg.cholesky(arrow.own)
    noise = _noise_factor(problem, simulated.residual, factor)
    found = sensitivity(arrow, tracker.parameters, fit.theta, max(noise, 1.0), active)
    scale = tracker.parameters.prior.std
    spread = found.covariance / (scale * scale.unsqueeze(-1))
    volume = 0.5 * torch.logdet(spread) - factor.diagonal(dim1=-2, dim2=-1).log().sum()
    return Optimum(fit, found, noise, total_cost(tracker, fit), float(volume))


def _noise_factor(
    problem: Problem, residual: Float[Tensor, "N T1 k"], factor: Float[Tensor, "N z z"]
) -> float:
    """Root mean square residual of the recorded numbers over the assumed standard deviation.

    Fitted unknowns take degrees of freedom as far as the tracks, not their priors, determine them:
    tr H⁻¹ (H - 1) of each track, with the Cholesky factor of H.
    """
    targets = problem.targets
    recorded = 2 * targets.weight.sum() + (targets.control_weight > 0).sum()
    inverse = torch.cholesky_inverse(factor)
    taken = factor.shape[-1] - inverse.diagonal(dim1=-2, dim2=-1).sum(-1)
    freedom = max(float(recorded - taken.sum()), 1.0)
    return math.sqrt(float(residual.square().sum()) / freedom)


def shares(optima: Sequence[Optimum]) -> Float[Tensor, " k"]:
    """Posterior mass of each of all, under the noise that fits the best of them."""
    excess = max(min(each.noise_factor for each in optima), 1.0)
    logs = [each.log_volume - each.cost / excess**2 for each in optima]
    return torch.softmax(torch.tensor(logs, dtype=torch.float64), 0)


def spread(
    optima: Sequence[Optimum], values: Float[Tensor, "k q"], variances: Float[Tensor, "k q"]
) -> Float[Tensor, " q"]:
    """Mean square error of the first of some values, given their variances at each optimum."""
    weights = shares(optima).to(values).unsqueeze(-1)
    return (weights * (variances + (values - values[0]).square())).sum(0)


def together(optima: Sequence[Optimum], parameters: LearnedParameters) -> Sensitivity:
    """What the first optimum says, with deviations that the others widen, to the prior's at most.

    Information, covariance and directions remain those of the first: they belong to a point.
    """
    first = optima[0].sensitivity
    values = torch.stack([parameters.values(each.fit.theta) for each in optima])
    variances = torch.stack([each.sensitivity.std.square() for each in optima])
    prior = parameters.prior.std
    std = spread(optima, values, variances).sqrt().clamp(first.std, prior)
    return first._replace(std=std, marginal_ratio=std / prior)


def alike(one: Optimum, other: Optimum, parameters: LearnedParameters) -> bool:
    """Whether two optima are the same within their accuracy."""
    apart = parameters.values(one.fit.theta) - parameters.values(other.fit.theta)
    return bool((apart.abs() <= APART * one.sensitivity.std).all())


def scattered(parameters: LearnedParameters, count: int) -> Float[Tensor, "count p"]:
    """θ spread over the prior by a Sobol sequence, the same in every call."""
    engine = torch.quasirandom.SobolEngine(max(len(parameters), 1), scramble=True, seed=0)
    # an engine refuses to draw nothing
    even = engine.draw(max(count, 1), dtype=parameters.middle.dtype)[:count, : len(parameters)]
    deviations = torch.special.ndtri(even).clamp(-SCATTER, SCATTER)
    return parameters.theta_for(parameters.prior.mean + deviations * parameters.prior.std)
