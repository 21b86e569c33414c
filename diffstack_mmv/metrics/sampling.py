"""Scores of sampled paths: the best of several, as for pedestrians, and all of them together."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.quasirandom import SobolEngine

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.geometry import symmetric_root
from diffstack_mmv.metrics.displacement import displacement_curve
from diffstack_mmv.metrics.draws import components_of, drawn_rows
from diffstack_mmv.metrics.means import time_mean
from diffstack_mmv.types import Forecast, Tracks

PATHS = 20
"""How many paths benchmarks draw."""


def sampled_paths(
    forecast: Forecast, count: int = PATHS, seed: int = 0, first: int = 0
) -> Float[Tensor, "*b S T 2"]:
    """Draw paths in m: a component, and one deviation in units of its covariance for all times.

        p_t = μ_zt + S_zt ε,    z ~ w,    ε ~ N(0, I)

    with the symmetric root S of the covariance, so that draws do not depend on the axes.

    Each time alone is distributed as forecast; the deviation lasts, as those of people do.

    Args:
        forecast: Mixtures, *b.
        count: Number S of paths of each.
        seed: Of the draws.
        first: Number of the first forecast, see `drawn_rows`.
    """

    def draw(generator: torch.Generator) -> Tensor:
        share = torch.rand(count, 1, generator=generator)
        return torch.cat([share, torch.randn(count, 2, generator=generator)], -1)

    drawn = drawn_rows(forecast.log_weight.shape[:-1], draw, seed, first)
    component = components_of(forecast.log_weight, drawn[..., 0])
    return _paths(forecast, component, drawn[..., 1:].to(forecast.mean))


def spread_paths(
    forecast: Forecast, count: int = PATHS, seed: int = 0, first: int = 0
) -> Float[Tensor, "*b S T 2"]:
    """As `sampled_paths`, but of evenly spread draws: no two paths of a forecast nearly alike.

    Randomised quasi-Monte Carlo: a scrambled Sobol sequence of (component, ε), shifted by another
    random vector for each forecast, so that each path alone is distributed as if it were drawn on
    its own. Their mean, too, is nearer to that of the forecast. They are not independent, so
    scores of pairs such as `energy_score` do not hold for them.
    Source: Bae et al., Non-Probability Sampling Network for Stochastic Human Trajectory
    Prediction, 2022, section 3; Cranley and Patterson, 1976, for the shift.

    Args:
        forecast: Mixtures, *b.
        count: Number S of paths of each.
        seed: Of scrambling and shift.
        first: Number of the first forecast, see `drawn_rows`.
    """

    def draw(generator: torch.Generator) -> Tensor:
        return torch.rand(1, 3, generator=generator, dtype=torch.float64)

    points = SobolEngine(3, scramble=True, seed=seed).draw(count, dtype=torch.float64)
    shift = drawn_rows(forecast.log_weight.shape[:-1], draw, seed, first)
    uniform = (points + shift) % 1.0
    component = components_of(forecast.log_weight, uniform[..., 0])
    smallest = torch.finfo(torch.float64).eps  # 0 has no quantile
    noise = torch.special.ndtri(uniform[..., 1:].clamp_min(smallest))
    return _paths(forecast, component, noise.to(forecast.mean))


def _paths(
    forecast: Forecast, component: Int[Tensor, "*b S"], noise: Float[Tensor, "*b S 2"]
) -> Float[Tensor, "*b S T 2"]:
    """Mean of the component and the deviation in units of its covariance for all times."""
    which = component[..., None, None]
    mean = forecast.mean.take_along_dim(which, -3)
    scale = forecast.scale_tril.take_along_dim(which.unsqueeze(-1), -4)
    return mean + (symmetric_root(scale) @ noise[..., None, :, None]).squeeze(-1)


def best_of_samples(
    forecast: Forecast, future: Tracks, seed: int = 0, first: int = 0
) -> dict[str, Float[Tensor, "*b"]]:
    """Smallest ADE and smallest FDE in m among 20 sampled paths, each on its own.

    Returns:
        best_of_20_ade and best_of_20_fde of independent draws, as published tables have them, and
        the same with `spread` for those of `spread_paths`; NaN where no time, or not the last
        one, is valid.
    """
    best: dict[str, Tensor] = {}
    for name, draw in (("best_of_20", sampled_paths), ("best_of_20_spread", spread_paths)):
        distance = displacement_curve(draw(forecast, PATHS, seed, first).movedim(-3, 0), future)
        average = time_mean(distance, future.valid.expand_as(distance))
        best |= {f"{name}_ade": average.amin(0), f"{name}_fde": distance[..., -1].amin(0)}
    return best


def energy_score(
    forecast: Forecast, future: Tracks, count: int = PATHS, seed: int = 0, first: int = 0
) -> Float[Tensor, "*b"]:
    """Energy score of the positions in m, mean over time; for a single certain path it is its ADE.

        E |p - y| - 1/2 E |p - p'|,    p, p' drawn from the forecast, y the truth

    A proper score: in the mean no forecast beats the true distribution, so it weighs accuracy and
    sharpness in one number, in the unit of the ADE, and without a density. Source: Gneiting and
    Raftery, Strictly Proper Scoring Rules, Prediction, and Estimation, 2007; unbiased estimator.

    Returns:
        The score; NaN where no time is valid.

    Raises:
        ValueError: Fewer than two draws, which make no pair.
    """
    require_at_least("count", count, 2)
    # imported here, since it compiles for seconds and only evaluations need it
    from scoringrules import es_ensemble

    paths = sampled_paths(forecast, count, seed, first)
    truth = future.motion.position
    score: Any = es_ensemble  # its type speaks of arrays of other packages
    each = score(truth, paths, m_axis=-3, v_axis=-1, estimator="fair", backend="torch")
    return time_mean(each, future.valid)
