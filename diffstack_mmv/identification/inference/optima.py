"""Local optima of a fit, their posterior masses, and the uncertainty of all together.

Tyres act on a path mostly by their cornering stiffness 2 c_p ℓ², so a stiff short contact and a
soft long one may explain tracks equally well: the posterior has several modes. A single fit,
however good, knows the width of its mode only. Fits from starts all over the prior
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

from diffstack_mmv.identification.inference.clusters import cluster_std, track_scores
from diffstack_mmv.identification.inference.sensitivity import Sensitivity, sensitivity
from diffstack_mmv.identification.shooting.block_arrowhead import BlockArrowhead
from diffstack_mmv.identification.shooting.fit import ParameterFit, total_cost
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.normal_equations import normal_equations
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.problem import TrackingProblem

DISTINCT = 0.5  # standard deviations between two different optima
NEGLIGIBLE = 1e-3  # share of the posterior of an optimum that is as good as none


class LocalOptimum(NamedTuple):
    """A fit with its sensitivity and its posterior mass."""

    fit: ParameterFit
    sensitivity: Sensitivity
    noise_factor: float  # deviation of the residuals over the assumed one
    cost: float  # of the tracks and the prior
    log_volume: float  # of the posterior mode, up to a constant


def analyse_optimum(
    simulator: TrackSimulator,
    problem: TrackingProblem,
    fit: ParameterFit,
    active: Bool[Tensor, " p"] | None = None,
) -> LocalOptimum:
    """Sensitivity and posterior mass at a fit; noise above the assumed one reduces the information.

    Args:
        simulator: Model and residuals.
        problem: The fitted tracks.
        fit: The fit, tracks without gaps.
        active: Which values were fitted, all by default.
    """
    unknowns, simulated, _ = fit.fitted
    jacobian = simulator.jacobian(fit.theta, problem, unknowns, simulated)
    system = normal_equations(jacobian, simulated.residual, unknowns)
    factor = torch.linalg.cholesky(system.local)
    recorded = simulator.vehicle.recorded_columns(simulated.residual.shape[-1])
    noise = _noise_factor(problem, simulated.residual, jacobian.local, factor, recorded)
    found = sensitivity(system, simulator.parameters, fit.theta, max(noise, 1.0), active)
    found = found.widened(_spread_of_tracks(simulator, fit, system, jacobian.shared, active))
    scale = simulator.parameters.prior.std
    spread = found.covariance / (scale * scale.unsqueeze(-1))
    volume = 0.5 * torch.logdet(spread) - factor.diagonal(dim1=-2, dim2=-1).log().sum()
    return LocalOptimum(fit, found, noise, total_cost(simulator, fit), float(volume))


def _spread_of_tracks(
    simulator: TrackSimulator,
    fit: ParameterFit,
    system: BlockArrowhead,
    rows: Float[Tensor, "N r p"],
    active: Bool[Tensor, " p"] | None,
) -> Float[Tensor, " p"]:
    """Deviations of the fitted values by the sandwich over tracks, zero for the others."""
    fitted = torch.ones_like(fit.theta) > 0 if active is None else active
    slope = simulator.parameters.slope(fit.theta)[fitted]
    residual = fit.fitted.simulated.residual.flatten(1)
    information, gradient = track_scores(system.restricted(fitted), rows[..., fitted], residual)
    std = torch.zeros_like(fit.theta)
    std[fitted] = cluster_std(
        information / (slope * slope.unsqueeze(-1)),
        gradient / slope,
        simulator.parameters.prior.std[fitted] ** -2,
    )
    return std


def _noise_factor(
    problem: TrackingProblem,
    residual: Float[Tensor, "N T1 k"],
    slope: Float[Tensor, "N r z"],
    factor: Float[Tensor, "N z z"],
    recorded: Sequence[int],
) -> float:
    """Root mean square residual of the recorded numbers over the assumed standard deviation.

    Fitted unknowns take degrees of freedom as far as the recorded numbers, not priors, determine
    them: tr H⁻¹ Jᵀ J of each track, with the Cholesky factor of H and the rows J of these numbers.
    """
    columns = residual.shape[-1]
    rows = slope.unflatten(1, (-1, columns))[:, :, list(recorded)].flatten(1, 2)
    taken = torch.linalg.solve_triangular(factor, rows.mT, upper=False).square().sum()
    measurements = problem.measurements
    count = 2 * measurements.weight.sum() + (measurements.control_weight > 0).sum()
    freedom = max(float(count - taken), 1.0)
    return math.sqrt(float(residual[..., list(recorded)].square().sum()) / freedom)


def posterior_shares(optima: Sequence[LocalOptimum]) -> Float[Tensor, " k"]:
    """Posterior mass of each optimum, under the noise that fits the best of them."""
    excess = max(min(each.noise_factor for each in optima), 1.0)
    logs = [each.log_volume - each.cost / excess**2 for each in optima]
    return torch.softmax(torch.tensor(logs, dtype=torch.float64), 0)


def relevant_optima(optima: Sequence[LocalOptimum]) -> tuple[LocalOptimum, ...]:
    """The optima whose share of the posterior counts, that of the largest one first."""
    shares = posterior_shares(optima).tolist()
    order = sorted(range(len(optima)), key=lambda index: -shares[index])
    return tuple(optima[index] for index in order if shares[index] >= NEGLIGIBLE)


def mixture_variance(
    optima: Sequence[LocalOptimum], values: Float[Tensor, "k q"], variances: Float[Tensor, "k q"]
) -> Float[Tensor, " q"]:
    """Mean square error of the first of some values, given their variances at each optimum."""
    weights = posterior_shares(optima).to(values).unsqueeze(-1)
    return (weights * (variances + (values - values[0]).square())).sum(0)


def combined_sensitivity(
    optima: Sequence[LocalOptimum], parameters: ParameterVector
) -> Sensitivity:
    """Sensitivity of the first optimum, with deviations that the others widen up to the prior's.

    Information, covariance and directions remain those of the first: they belong to a point.
    """
    first = optima[0].sensitivity
    values = torch.stack([parameters.values(each.fit.theta) for each in optima])
    variances = torch.stack([each.sensitivity.std.square() for each in optima])
    prior = parameters.prior.std
    std = mixture_variance(optima, values, variances).sqrt().clamp(first.std, prior)
    return first._replace(std=std, marginal_ratio=std / prior)


def is_same_optimum(one: LocalOptimum, other: LocalOptimum, parameters: ParameterVector) -> bool:
    """Whether two optima are the same within their accuracy."""
    apart = parameters.values(one.fit.theta) - parameters.values(other.fit.theta)
    return bool((apart.abs() <= DISTINCT * one.sensitivity.std).all())
