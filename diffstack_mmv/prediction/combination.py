"""One path out of estimates that err differently."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import times_ahead
from diffstack_mmv.prediction.current import steady_path
from diffstack_mmv.types import Tracks

STEADY_SHARE = 0.2
"""Share of the constant velocity, chosen on the validation splits of ETH and UCY."""
WINDOW_S = 0.5
"""Time over which the velocity is measured, as by `ConstantVelocity`."""


def combined_path(
    median: Float[Tensor, "*b T 2"], mean: Float[Tensor, "*b T 2"], past: Tracks, dt_s: float
) -> Float[Tensor, "*b T 2"]:
    """The middle of median and mean of a forecast, a fifth of the way towards constant velocity.

        (1 - κ) (q(t) + m(t)) / 2 + κ (p₀ + t v₀),    κ = 0.2

    with the median q and the mean m of the forecast, the last position p₀ and the mean velocity v₀
    of the last 0.5 s. Averages of estimates that err differently are better than the single ones
    (Bates and Granger, "The Combination of Forecasts", 1969): a learned forecast knows more of the
    end, the last steps of a track that was annotated smoothly know more of the beginning.

    Args:
        median: q, of the forecast of the agents, in m.
        mean: m, of the same forecast, in m.
        past: Their tracks, in the same frame.
        dt_s: Length of one step in s.

    Returns:
        Path in m.
    """
    time = times_ahead(mean, mean.shape[-2], dt_s)
    steady = steady_path(past, time, max(round(WINDOW_S / dt_s), 1), dt_s)
    return torch.lerp(torch.lerp(median, mean, 0.5), steady, STEADY_SHARE)
