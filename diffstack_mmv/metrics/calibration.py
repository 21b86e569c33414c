"""Whether a forecast is as sure as it should be: coverage of its regions of highest density."""

from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.metrics.means import time_mean
from diffstack_mmv.types import Forecast, Tracks

REGIONS = (0.5, 0.9)
"""Probabilities of the regions whose coverage is told."""
EVERY = 3
"""Every third time is judged: neighboring ones tell the same."""
AT_ONCE = 8
"""Mixtures whose densities are computed at once: what comes in between stays in the cache."""


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
    index = drawn.to(mean.device)[..., None, None]
    own_mean = mean.take_along_dim(index, -3)
    own_scale = scale.take_along_dim(index.unsqueeze(-1), -4)
    noise = torch.randn(own_mean.shape, generator=generator, dtype=mean.dtype).to(mean.device)
    # samples last: all that is done to them is done along memory, see `_density`
    sampled = (own_mean + _scaled(own_scale, noise)).movedim(-3, -1)
    truth = position.unsqueeze(-1)
    pairs = [(forecast, sampled, truth)]
    if count > AT_ONCE and weight.dim() == 2:
        pairs = list(zip(*(_parts(each) for each in pairs[0]), strict=True))
    denser = [_density(part, one) > _density(part, other) for part, one, other in pairs]
    return torch.cat(denser).to(mean.dtype).mean(-1)


def _parts(field: Forecast | Tensor) -> Iterator[Any]:
    """Some mixtures at a time."""
    if isinstance(field, Tensor):
        return iter(field.split(AT_ONCE))
    return map(Forecast._make, zip(*(part.split(AT_ONCE) for part in field), strict=True))


def _scaled(
    scale_tril: Float[Tensor, "*b 2 2"], noise: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b 2"]:
    """L n; faster by far than a library call per matrix."""
    return torch.stack(
        [
            scale_tril[..., 0, 0] * noise[..., 0],
            scale_tril[..., 1, 0] * noise[..., 0] + scale_tril[..., 1, 1] * noise[..., 1],
        ],
        -1,
    )


def _density(forecast: Forecast, position: Float[Tensor, "*b T 2 S"]) -> Float[Tensor, "*b T S"]:
    """Density of several positions at each time, in units of the tallest component."""
    mean, root = forecast.mean.movedim(-3, -2), forecast.scale_tril.movedim(-4, -3)
    first, cross, second = (
        root[..., row, column].unsqueeze(-1) for row, column in ((0, 0), (1, 0), (1, 1))
    )
    x, y = (position[..., axis, :].unsqueeze(-2) - mean[..., axis].unsqueeze(-1) for axis in (0, 1))
    white = x.div_(first)
    rest = torch.addcmul(y, cross, white, value=-1, out=y).div_(second)
    squared = white.square_().addcmul_(rest, rest)
    height = forecast.log_weight[..., None, :, None] - (first * second).log()
    height = height - height.amax(-2, keepdim=True)
    return torch.sub(height, squared, alpha=0.5, out=squared).exp_().sum(-2)
