"""Scores of sampled paths: the best of several, as for pedestrians, and all of them together."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.metrics.displacement import displacement
from diffstack_mmv.metrics.means import time_mean
from diffstack_mmv.types import Forecast, Tracks

PATHS = 20
"""How many paths benchmarks draw."""


def sampled_paths(
    forecast: Forecast, count: int = PATHS, seed: int = 0
) -> Float[Tensor, "*b S T 2"]:
    """Draw paths in m: a component, and one deviation in units of its covariance for all times.

        p_t = μ_zt + L_zt ε,    z ~ w,    ε ~ N(0, I)

    Each time alone is distributed as forecast; the deviation lasts, as those of people do.

    Args:
        forecast: Mixtures, *b.
        count: Number S of paths of each.
        seed: Of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    weight = forecast.log_weight.exp()
    flat = weight.reshape(-1, weight.shape[-1]).cpu()
    drawn = torch.multinomial(flat, count, replacement=True, generator=generator)
    component = drawn.reshape(*weight.shape[:-1], count, 1, 1).to(weight.device)
    mean = forecast.mean.take_along_dim(component, -3)
    scale = forecast.scale_tril.take_along_dim(component.unsqueeze(-1), -4)
    noise = torch.randn(*mean.shape[:-2], 1, 2, 1, generator=generator).to(mean)
    return mean + (scale @ noise).squeeze(-1)


def best_of_samples(
    forecast: Forecast, future: Tracks, count: int = PATHS, seed: int = 0
) -> dict[str, Float[Tensor, "*b"]]:
    """Smallest ADE and smallest FDE in m among sampled paths, each on its own.

    Returns:
        best_of_20_ade and best_of_20_fde; NaN where no time, or not the last one, is valid.
    """
    paths = sampled_paths(forecast, count, seed).movedim(-3, 0)
    distance = displacement(paths, future)
    average = time_mean(distance, future.valid.expand_as(distance))
    return {
        "best_of_20_ade": average.amin(0),
        "best_of_20_fde": distance[..., -1].amin(0),
    }


def energy_score(
    forecast: Forecast, future: Tracks, count: int = PATHS, seed: int = 0
) -> Float[Tensor, "*b"]:
    """Energy score of the positions in m, mean over time; for a single certain path it is its ADE.

        E |p - y| - 1/2 E |p - p'|,    p, p' drawn from the forecast, y the truth

    A proper score: in the mean no forecast beats the true distribution, so it weighs accuracy and
    sharpness in one number, in the unit of the ADE, and without a density. Source: Gneiting and
    Raftery, Strictly Proper Scoring Rules, Prediction, and Estimation, 2007; unbiased estimator.

    Returns:
        The score; NaN where no time is valid.
    """
    # imported here, since it compiles for seconds and only evaluations need it
    from scoringrules import es_ensemble

    paths = sampled_paths(forecast, count, seed)
    truth = future.motion.position
    score: Any = es_ensemble  # its type speaks of arrays of other packages
    each = score(truth, paths, m_axis=-3, v_axis=-1, estimator="fair", backend="torch")
    return time_mean(each, future.valid)
