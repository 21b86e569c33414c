"""How noisy the positions of a track are, from the track alone."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.types import Tracks

ORDERS = (2, 3)
"""Of the differences: motion is in them by its acceleration and its jerk, noise in both alike."""
NOISE_GAIN = (6.0, 20.0)  # variance of such a difference of positions with noise of variance one
SMOOTH_M = 1e-3  # noise that is as good as none
USUAL_M = 1e-2


def roughness(tracks: Tracks) -> Float[Tensor, "R 2"]:
    """Logarithms of the noise that would explain second and third differences, of order one.

    A track with white noise has the same in both, a smooth one that turns or brakes less in the
    third. A difference counts where all of its positions are valid; none counts as no noise.

    Args:
        tracks: Agents `R H`, their positions in m.
    """
    difference, valid = tracks.motion.position, tracks.valid
    found = []
    for order in range(1, max(ORDERS) + 1):
        difference, valid = difference.diff(dim=-2), valid[..., 1:] & valid[..., :-1]
        if order in ORDERS:
            gain = NOISE_GAIN[ORDERS.index(order)]
            square = (difference.square().mean(-1) * valid).sum(-1)
            variance = square / (gain * valid.sum(-1).clamp(min=1))
            found.append(variance)
    noise = torch.stack(found, -1) + SMOOTH_M**2
    return 0.5 * torch.log(noise / USUAL_M**2)
