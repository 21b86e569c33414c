"""How probable the truth was under a forecast."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.metrics.displacement import ForecastMetric, time_mean
from diffstack_mmv.types import Forecast, Tracks

LOG_PROB_FLOOR = -20.0  # nats; so that no single position decides over a mean. Source: DiffStack


def negative_log_likelihood(
    forecast: Forecast, future: Tracks, floor: float = LOG_PROB_FLOOR
) -> Float[Tensor, "*b"]:
    """Mean over the valid times of -max(log p(position), floor) in nats, p of the mixture."""
    log_prob = forecast.log_prob(future.motion.position)
    return -time_mean(log_prob.clamp_min(floor), future.valid)


class NegativeLogLikelihood(ForecastMetric):
    """NLL of the true positions under the forecast, log probabilities floored at -20 nats."""

    higher_is_better = False
    unit = "nats"
    title = "NLL"

    def scores(self, forecast: Forecast, future: Tracks) -> Float[Tensor, "*b"]:
        """NLL of each sample in nats."""
        return negative_log_likelihood(forecast, future)
