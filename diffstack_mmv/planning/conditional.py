"""A forecast of somebody whose destination is known."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import (
    scale_from_covariance,
    shares_ahead,
    solve_symmetric,
    symmetric_root,
)
from diffstack_mmv.types import Forecast, log_density

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
    share = shares_ahead(mean, mean.shape[-2])
    root, covariance = symmetric_root(scale), scale @ scale.mT
    white = solve_symmetric(root[..., -1, :, :], error).unsqueeze(-2)
    moved = mean + share.sqrt().unsqueeze(-1) * (root * white.unsqueeze(-2)).sum(-1)
    rest = scale_from_covariance((1 - share)[:, None, None] * covariance, width_m**2)
    blurred = scale_from_covariance(covariance[..., -1, :, :], width_m**2)
    log_weight = forecast.log_weight + log_density(error, blurred)
    return Forecast(log_weight.log_softmax(-1), moved, rest)
