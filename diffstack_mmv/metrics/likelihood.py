"""How probable the truth was under a forecast."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.metrics.means import time_mean
from diffstack_mmv.types import Forecast, Tracks

LOG_PROB_FLOOR = -20.0  # nats; so that no single position decides over a mean. Source: DiffStack


def negative_log_likelihood(
    forecast: Forecast, future: Tracks, floor: float = LOG_PROB_FLOOR
) -> Float[Tensor, "*b"]:
    """Mean over the valid times of -max(log p(position), floor) in nats, p of the mixture.

    NaN where no time is valid.
    """
    position = future.motion.position
    # what stands in rows that are not valid must not reach the gradient
    position = torch.where(future.valid.unsqueeze(-1), position, torch.zeros_like(position))
    return -time_mean(forecast.log_prob(position).clamp_min(floor), future.valid)
