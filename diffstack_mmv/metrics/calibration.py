"""Whether a forecast is as sure as it should be: coverage of its regions of highest density."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.metrics.means import time_mean
from diffstack_mmv.types import Forecast, Tracks

REGIONS = (0.5, 0.9)
"""Probabilities of the regions whose coverage is told."""
EVERY = 3
"""Every third time is judged: neighboring ones tell the same."""


def coverages(
    forecast: Forecast, future: Tracks, samples: int = 128, seed: int = 0
) -> dict[str, Float[Tensor, "*b"]]:
    """Share of the times at which the truth lay in the smallest region of each probability.

    Returns:
        coverage_50 and coverage_90, dimensionless; NaN where no time is valid. Over many samples
        the means of a calibrated forecast are 0.5 and 0.9.
    """
    thinned = slice(EVERY - 1, None, EVERY)
    thin = Forecast(
        forecast.log_weight, forecast.mean[..., thinned, :], forecast.scale_tril[..., thinned, :, :]
    )
    truth, valid = future.motion.position[..., thinned, :], future.valid[..., thinned]
    level = density_level(thin, truth, samples, seed)
    return {f"coverage_{round(100 * region)}": _share(level <= region, valid) for region in REGIONS}


def _share(inside: Bool[Tensor, "*b T"], valid: Bool[Tensor, "*b T"]) -> Float[Tensor, "*b"]:
    return time_mean(inside.to(torch.get_default_dtype()), valid)


def density_level(
    forecast: Forecast, position: Float[Tensor, "*b T 2"], samples: int = 128, seed: int = 0
) -> Float[Tensor, "*b T"]:
    """Probability of the region in which the forecast is denser than at a position.

    Uniform on [0, 1] over the truths of a calibrated forecast. Source: Hyndman, Computing and
    Graphing Highest Density Regions, The American Statistician 50, 1996; from samples.

    Args:
        forecast: Mixtures `*b`.
        position: In m.
        samples: Drawn from each mixture.
        seed: Of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    mean, scale = forecast.mean, forecast.scale_tril
    weight = forecast.log_weight.exp()
    count = weight.reshape(-1, weight.shape[-1]).shape[0]
    drawn = torch.multinomial(
        weight.reshape(count, -1).cpu(), samples, replacement=True, generator=generator
    ).reshape(*weight.shape[:-1], samples)
    index = drawn.to(mean.device)[..., None, None, None]
    own_mean = mean.unsqueeze(-4).take_along_dim(index, -3).squeeze(-3)
    own_scale = scale.unsqueeze(-5).take_along_dim(index.unsqueeze(-1), -4).squeeze(-4)
    noise = torch.randn(own_mean.shape, generator=generator, dtype=mean.dtype).to(mean.device)
    sampled = own_mean + (own_scale @ noise.unsqueeze(-1)).squeeze(-1)
    denser = _log_density(forecast, sampled) > _log_density(forecast, position.unsqueeze(-3))
    return denser.to(mean.dtype).mean(-2)


def _log_density(
    forecast: Forecast, position: Float[Tensor, "*b S T 2"]
) -> Float[Tensor, "*b S T"]:
    """Log density in nats of several positions at each time; the roots are solved by hand."""
    error = position.unsqueeze(-3) - forecast.mean.unsqueeze(-4)
    root = forecast.scale_tril.unsqueeze(-5)
    first, cross, second = root[..., 0, 0], root[..., 1, 0], root[..., 1, 1]
    white = error[..., 0] / first
    rest = (error[..., 1] - cross * white) / second
    log_density = -0.5 * (white.square() + rest.square()) - (first * second).log()
    weighted = forecast.log_weight[..., None, :, None] + log_density
    return weighted.logsumexp(-2) - math.log(2 * math.pi)
