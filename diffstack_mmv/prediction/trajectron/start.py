"""Where an agent is and how it moves now: estimates from its track, and what is made of them."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.prediction.current import MEMORY_S, Trend, mean_velocity, rest, trends
from diffstack_mmv.types import Tracks

OTHER_MEMORIES_S = (0.3, 1.5)
"""Of two more fits: what differs between a short and a long memory tells what changes."""
REST_MEMORY_S = 1.0
REST_REACH_M = 0.5
ESTIMATES = 4 + len(OTHER_MEMORIES_S)
START_FEATURES = 6 * ESTIMATES - 18  # without what is zero or follows from others
OFFSET_SCALE_M = 0.3
ACCELERATION_SCALE_MPS2 = 2.0


def estimates(tracks: Tracks, dt_s: float) -> Trend:
    """Estimates `R S` of the present motion of agents `R`, in the frame of their positions.

    The fit as it moves, but in the last position; the fit in its own position; fits with other
    memories; the way of the last step; and rest in the mean position. No one of them is the best
    for all tracks: some are noisy and some are smooth, some agents turn, brake or stand.
    """
    fits = trends(tracks, (MEMORY_S, *OTHER_MEMORIES_S), dt_s)
    zero = torch.zeros_like(fits[0].offset)
    now = fits[0]._replace(offset=zero)
    last = Trend(zero, mean_velocity(tracks, 1, dt_s), zero)
    found = now, *fits, last, rest(tracks, REST_MEMORY_S, REST_REACH_M, dt_s)
    return Trend(*(torch.stack(fields, -2) for fields in zip(*found, strict=True)))


def start_features(starts: Trend) -> Float[Tensor, "R f"]:
    """How estimates `R S` differ from the first, of order one."""
    offset = starts.offset[:, 1:] / OFFSET_SCALE_M
    faster = (starts.velocity - starts.velocity[:, :1])[:, 2:-1]
    acceleration = starts.acceleration[:, 2:-2] / ACCELERATION_SCALE_MPS2
    parts = offset[:, :-2], offset[:, -1:], faster, acceleration
    return torch.cat([part.flatten(1) for part in parts], -1)


class StartBlend(nn.Module):
    """The present motion by each component: the first estimate x₁, moved to the others by gains.

        x = x₁ + Σ_k tanh(g_k) (x_k - x₁),    g = W [context, 1] + W_z

    The gains start at zero, so that an untrained predictor starts from the first estimate. They are
    the learned counterpart of those of a Kalman filter, which also tell noise from manoeuvres.

    Args:
        context_size: Size of the encoding of the present scene.
        components: Number K of components.
    """

    def __init__(self, context_size: int, components: int) -> None:
        super().__init__()
        self.components = components
        self.gains = nn.Linear(context_size, components * (ESTIMATES - 1))
        nn.init.zeros_(self.gains.weight)
        nn.init.zeros_(self.gains.bias)

    def forward(self, context: Float[Tensor, "R c"], starts: Trend) -> Trend:
        """Motion `R K` of each row and component, in the frame of the estimates."""
        gain = torch.tanh(self.gains(context)).unflatten(-1, (self.components, -1))
        moved = (gain @ (field[:, 1:] - field[:, :1]) for field in starts)
        return Trend(*(field[:, :1] + move for field, move in zip(starts, moved, strict=True)))
