"""Whether a forecast is as sure as it should be: coverage of its regions of highest density."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.metrics.draws import components_of, drawn_rows
from diffstack_mmv.metrics.means import time_mean
from diffstack_mmv.types import Forecast, Tracks

REGIONS = (0.5, 0.9)
"""Probabilities of the regions whose coverage is told."""
EVERY = 3
"""Every third time is judged: neighboring ones tell the same."""
AT_ONCE = 8
"""Mixtures whose densities are computed at once: what comes in between stays in the cache."""


class DensityLevels(NamedTuple):
    """Where truths lie in their forecasts, and how large regions of highest density are."""

    # of the smallest region that holds the truth; beyond all samples 1 and the nats that it is
    # less dense than the least dense of them
    level: Float[Tensor, "*b T"]
    valid: Bool[Tensor, "*b T"]
    drawn: Float[Tensor, "*b S T"]  # log densities in nats of samples of the forecast

    def area(self, level: Float[Tensor, "#T"]) -> Float[Tensor, "*b T"]:
        """Area in m² of the region of highest density of a level, by its samples.

        Beyond the samples it grows as that of a Gaussian does, in proportion to the nats.
        """
        order = self.drawn.sort(-2, descending=True).values
        rank = torch.arange(1, order.shape[-2] + 1, device=order.device).unsqueeze(-1)
        inside = rank <= (level * order.shape[-2]).floor()  # as many as `coverages` counts
        area = torch.where(inside, (-order).exp(), torch.zeros_like(order)).mean(-2)
        depth = (order[..., 0, :] - order[..., -1, :]).clamp_min(1e-6)
        return area * (1 + (level - 1).clamp_min(0) / depth)


class Calibration(NamedTuple):
    """Levels of the forecast at which its regions hold what they should, from other recordings.

    Split conformal: of n truths of recordings that took no part in the training, the share
    ⌈(n + 1) p⌉ / n lies in the region of the level q(p) of the forecast; on exchangeable truths so
    does the share p, whatever the forecast is. Source: Vovk et al., Algorithmic Learning in a
    Random World, 2005; Angelopoulos and Bates, A Gentle Introduction to Conformal Prediction, 2021.
    """

    levels: Float[Tensor, "R T"]  # q for each of `REGIONS`

    @classmethod
    def fitted(cls, level: Float[Tensor, "n T"], valid: Bool[Tensor, "n T"]) -> "Calibration":
        """Fit to the levels of the truths of held-out samples, each time on its own."""
        columns = []
        for values, known in zip(level.unbind(-1), valid.unbind(-1), strict=True):
            own = values[known].sort().values
            count = len(own)
            # with nothing to go by the whole plane
            padded = torch.cat([own, own.new_full((1,), torch.inf)])
            ranks = [min(math.ceil((count + 1) * region), count + 1) for region in REGIONS]
            columns.append(torch.stack([padded[rank - 1] for rank in ranks]))
        return cls(torch.stack(columns, -1))


def judged_levels(
    forecast: Forecast, future: Tracks, samples: int = 128, seed: int = 0, first: int = 0
) -> DensityLevels:
    """Levels of the truths at every third time: how probable it is to be where it is denser.

    Uniform on [0, 1] over the truths of a calibrated forecast, but for those beyond all samples,
    see `DensityLevels`. Source: Hyndman, Computing and Graphing Highest Density Regions, The
    American Statistician 50, 1996; from samples.

    Args:
        forecast: Mixtures `*b`.
        future: What happened.
        samples: Drawn from each mixture.
        seed: Of the draws.
        first: Number of the first forecast; the draws of each go by its number.
    """
    thinned = slice(EVERY - 1, None, EVERY)
    thin = Forecast(
        forecast.log_weight, forecast.mean[..., thinned, :], forecast.scale_tril[..., thinned, :, :]
    )
    truth, valid = future.motion.position[..., thinned, :], future.valid[..., thinned]
    drawn = drawn_densities(thin, samples, seed, first)
    return DensityLevels(_level(thin, truth, drawn), valid, drawn)


def coverages(
    levels: DensityLevels, calibration: Calibration | None = None
) -> dict[str, Float[Tensor, "*b"]]:
    """Share of the times at which the truth lay in the smallest region of each probability.

    Args:
        levels: What `judged_levels` returned.
        calibration: Levels of the forecast to use instead of the probabilities themselves.

    Returns:
        coverage_50 and coverage_90, dimensionless, area_50 and area_90 in m²; NaN where no time is
        valid. Over many samples the means of a calibrated forecast are 0.5 and 0.9; of two
        calibrated ones the better has the smaller areas.
    """
    told = {}
    for number, region in enumerate(REGIONS):
        nominal = levels.level.new_full((1,), region)
        level = nominal if calibration is None else calibration.levels[number].to(nominal)
        name = round(100 * region)
        told[f"coverage_{name}"] = _share(levels.level <= level, levels.valid)
        told[f"area_{name}"] = time_mean(levels.area(level), levels.valid)
    return told


def _share(inside: Bool[Tensor, "*b T"], valid: Bool[Tensor, "*b T"]) -> Float[Tensor, "*b"]:
    return time_mean(inside.to(torch.get_default_dtype()), valid)


def _level(
    forecast: Forecast, position: Float[Tensor, "*b T 2"], drawn: Float[Tensor, "*b S T"]
) -> Float[Tensor, "*b T"]:
    own = _log_density(forecast, position.unsqueeze(-1)).movedim(-1, -2)
    beyond = (drawn.amin(-2) - own.squeeze(-2)).clamp_min(0)
    return (drawn > own).to(drawn.dtype).mean(-2) + beyond


def drawn_densities(
    forecast: Forecast, samples: int, seed: int, first: int = 0
) -> Float[Tensor, "*b S T"]:
    """Log densities in nats of positions drawn from each mixture at each time."""
    mean, scale, leading = forecast.mean, forecast.scale_tril, forecast.log_weight.shape[:-1]
    count, steps = leading.numel(), mean.shape[-2]

    def draw(generator: torch.Generator) -> Tensor:
        share = torch.rand(samples, 1, generator=generator)
        return torch.cat([share, torch.randn(samples, 2 * steps, generator=generator)], -1)

    drawn = drawn_rows(leading, draw, seed, first)
    index = components_of(forecast.log_weight, drawn[..., 0])[..., None, None]
    own_mean = mean.take_along_dim(index, -3)
    own_scale = scale.take_along_dim(index.unsqueeze(-1), -4)
    noise = drawn[..., 1:].unflatten(-1, (steps, 2)).to(mean)
    # samples last: all that is done to them is done along memory, see `_log_density`
    sampled = (own_mean + _scaled(own_scale, noise)).movedim(-3, -1)
    parts = [(forecast, sampled)]
    if count > AT_ONCE and len(leading) == 1:
        parts = list(zip(_parts(forecast), _parts(sampled), strict=True))
    return torch.cat([_log_density(*part) for part in parts]).movedim(-1, -2)


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


def _log_density(
    forecast: Forecast, position: Float[Tensor, "*b T 2 S"]
) -> Float[Tensor, "*b T S"]:
    """Log density in nats of several positions at each time; the roots are solved by hand."""
    mean, root = forecast.mean.movedim(-3, -2), forecast.scale_tril.movedim(-4, -3)
    first, cross, second = (
        root[..., row, column].unsqueeze(-1) for row, column in ((0, 0), (1, 0), (1, 1))
    )
    x, y = (position[..., axis, :].unsqueeze(-2) - mean[..., axis].unsqueeze(-1) for axis in (0, 1))
    white = x.div_(first)
    rest = torch.addcmul(y, cross, white, value=-1, out=y).div_(second)
    squared = white.square_().addcmul_(rest, rest)
    height = forecast.log_weight[..., None, :, None] - (first * second).log()
    weighted = torch.sub(height, squared, alpha=0.5, out=squared)
    tallest = weighted.amax(-2, keepdim=True)
    total = weighted.sub_(tallest).exp_().sum(-2).log_()
    return total + tallest.squeeze(-2) - math.log(2 * math.pi)
