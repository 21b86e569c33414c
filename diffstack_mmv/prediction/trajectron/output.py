"""From rows back to scenes."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import position_from_frame, scale_from_covariance
from diffstack_mmv.prediction.current import current_position
from diffstack_mmv.prediction.gaussian import rotate_covariance
from diffstack_mmv.prediction.trajectron.agent_batch import AgentBatch
from diffstack_mmv.prediction.trajectron.mixture import PositionMoments
from diffstack_mmv.prediction.trajectron.rows import ChosenRows
from diffstack_mmv.types import Forecast, Tracks, map_tensors

ABSENT_LOG_WEIGHT = -1e4
"""Of components that an agent does not have; finite, so that 0 · log 0 is 0."""


def scenes(agents: Tracks) -> Tracks:
    """Agents `*b A` with all leading dimensions but the agent's in one, `B A`."""
    batch_dims = agents.mode.dim() - 1
    return map_tensors(lambda field: field.reshape(-1, *field.shape[batch_dims:]), agents)


def nobody(agents: Tracks, components: int, steps: int) -> Forecast:
    """Forecast of standing still, with 1 m of uncertainty, for agents of the shape `B A`."""
    position = current_position(agents).flatten(0, 1)
    mean = position[:, None, None, :].expand(-1, components, steps, 2)
    scale_tril = torch.eye(2, dtype=mean.dtype, device=mean.device).expand(*mean.shape, 2)
    return Forecast(padded(mean.new_zeros(len(mean), 1), components), mean, scale_tril)


def placed(
    forecast: Forecast,
    places: ChosenRows,
    rows: AgentBatch,
    log_prior: Float[Tensor, "S K"],
    moments: PositionMoments,
) -> Forecast:
    """Replace the forecast of the agents in some places by moments in their own frames.

    Agents with fewer components than the forecast get more of weight zero, which repeat the last
    one.
    """
    components = forecast.log_weight.shape[-1]
    missing = components - log_prior.shape[-1]

    def repeated(moment: Tensor) -> Tensor:
        return torch.cat([moment, moment[:, -1:].expand(-1, missing, *moment.shape[2:])], 1)

    heading = rows.heading[:, None, None]
    mean = position_from_frame(moments.mean, rows.origin[:, None, None, :], heading)
    scale_tril = scale_from_covariance(rotate_covariance(moments.covariance, heading))
    return Forecast(
        places.put(forecast.log_weight, padded(log_prior, components)),
        places.put(forecast.mean, repeated(mean)),
        places.put(forecast.scale_tril, repeated(scale_tril)),
    )


def padded(log_weight: Float[Tensor, "S k"], components: int) -> Float[Tensor, "S K"]:
    """Add components of weight zero."""
    missing = components - log_weight.shape[-1]
    return torch.nn.functional.pad(log_weight, (0, missing), value=ABSENT_LOG_WEIGHT)
