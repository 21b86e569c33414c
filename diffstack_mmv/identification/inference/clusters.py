"""Deviations from how much tracks contradict each other.

Laplace's approximation takes residuals for independent. Those of a track are not where its noise is
correlated, or where the model is slightly wrong for it. The sandwich with one cluster per track

    A⁻¹ (N / (N - 1) Σ_i g_i g_iᵀ) A⁻¹,   A = Σ_i S_i + P

(g_i the gradient of the cost of a track by the values, S_i its information, P the precision of the
priors) only takes tracks for independent of each other.

Source: Liang and Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73,
1986.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.shooting.block_arrowhead import BlockArrowhead

FEWEST = 3  # tracks from which on their spread is told


def track_scores(
    system: BlockArrowhead, jacobian: Float[Tensor, "N r p"], residual: Float[Tensor, "N r"]
) -> tuple[Float[Tensor, "N p p"], Float[Tensor, "N p"]]:
    """Information and gradient of θ of each track by itself, its unknowns eliminated.

    Args:
        system: Normal equations of all tracks at the solution, without priors of θ.
        jacobian: Derivatives of the residuals by θ.
        residual: Residuals of each track.
    """
    factor = torch.linalg.cholesky(system.local)
    half = torch.linalg.solve_triangular(factor, system.cross, upper=False)
    right = torch.linalg.solve_triangular(factor, system.local_gradient.unsqueeze(-1), upper=False)
    information = jacobian.mT @ jacobian - half.mT @ half
    gradient = (jacobian.mT @ residual.unsqueeze(-1) - half.mT @ right).squeeze(-1)
    return information, gradient


def cluster_std(
    information: Float[Tensor, "N a a"],
    gradient: Float[Tensor, "N a"],
    precision: Float[Tensor, " a"],
) -> Float[Tensor, " a"]:
    """Deviations of the fitted values by the sandwich over tracks; zero for few tracks.

    Args:
        information: Of each track about the values.
        gradient: Of the cost of each track by the values.
        precision: Of their priors.
    """
    count = len(gradient)
    if count < FEWEST:
        return torch.zeros_like(precision)
    moved = torch.linalg.solve(information.sum(0) + precision.diag(), gradient.mT)
    return (count / (count - 1) * moved.square().sum(-1)).sqrt()
