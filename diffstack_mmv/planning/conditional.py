"""A forecast of somebody whose destination is known."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import symmetric_root
from diffstack_mmv.types import Forecast

WIDTH_M = 0.1


def given_end(forecast: Forecast, end: Float[Tensor, "*b 2"], width_m: float = WIDTH_M) -> Forecast:
    """Condition a forecast on the position at its last time.

    A component counts by its weight times its density at the end, and is moved there:

        w_k ∝ w_k N(g; μ_kT, Σ_kT + σ² I),    μ_kt + ρ_t S_kt S_kT⁻¹ (g - μ_kT),    ρ_t = √(t / T)

    with the symmetric root S of Σ, which turns with the frame as no Cholesky factor does, and the
    correlation ρ_t between the position at t and at the end that independent steps have; what is
    left of the covariance at t is (1 - ρ_t²) Σ_kt + σ² I.

    Args:
        forecast: Mixtures, *b K T.
        end: Known position g in m.
        width_m: σ, how exactly the end is known; it also bounds the covariances from below.

    Returns:
        Mixtures with the same number of components.

    Raises:
        ValueError: The width is not positive.
    """
    require_positive("width_m", width_m)
    mean, scale = forecast.mean, forecast.scale_tril
    error = end.unsqueeze(-2) - mean[..., -1, :]
    steps = mean.shape[-2]
    share = torch.arange(1, steps + 1, dtype=mean.dtype, device=mean.device) / steps
    root, last = symmetric_root(scale), scale[..., -1, :, :]
    precise = torch.cholesky_solve(error.unsqueeze(-1), last)  # Σ_T⁻¹ (g - μ_T)
    white = (root[..., -1, :, :] @ precise).unsqueeze(-3)
    moved = mean + share.sqrt().unsqueeze(-1) * (root @ white).squeeze(-1)
    floor = width_m**2 * torch.eye(2, dtype=mean.dtype, device=mean.device)
    covariance = scale @ scale.mT
    rest = torch.linalg.cholesky((1 - share)[:, None, None] * covariance + floor)
    blurred = torch.linalg.cholesky(covariance[..., -1, :, :] + floor)
    surprise = torch.linalg.solve_triangular(blurred, error.unsqueeze(-1), upper=False)
    log_density = -0.5 * surprise.square().sum((-2, -1))
    log_density = log_density - blurred.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    return Forecast((forecast.log_weight + log_density).log_softmax(-1), moved, rest)
