"""What a place in a known intersection says about where its agents go."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_at_least, require_between, require_positive
from diffstack_mmv.geometry import direction
from diffstack_mmv.prediction.trajectron.encoder import perceptron
from diffstack_mmv.types import Pose

OCTAVES = 2  # the shortest wave is as long as `scale_m`
HIDDEN = 64


class Site(nn.Module):
    """Code of a pose in the world, for recordings of one site that is also the place of use.

    What it learns are the habits of that site (lanes, crossings, stop lines); they do not transfer
    to another one. A pose that is not known, as that of a mirrored sample, has the code zero.

    Args:
        center_m: Centre of the site in the world of its recordings, in m.
        scale_m: Half of its width in m.
        outputs: Size of the code.
        dropout: Share of the codes that are zero in training, so that the rest of the predictor
            also learns to do without.

    Raises:
        ValueError: A size is not positive, or the share is no share.
    """

    def __init__(
        self,
        center_m: Sequence[float] = (0.0, 0.0),
        scale_m: float = 20.0,
        outputs: int = 16,
        dropout: float = 0.2,
    ) -> None:
        super().__init__()
        require(len(center_m) == 2, "center_m", "have two entries (x, y)", list(center_m))
        require_positive("scale_m", scale_m)
        require_at_least("outputs", outputs, 1)
        require_between("dropout", dropout, 0.0, 0.9)
        self.outputs = outputs
        self.scale_m = scale_m
        self.dropout = dropout
        # in float64, as the places are: a map grid has coordinates of millions of metres
        self.register_buffer("center", torch.tensor(list(center_m), dtype=torch.float64))
        self.center: Tensor
        self.network = perceptron([2 + 4 * OCTAVES + 2, HIDDEN, outputs])

    def forward(self, place: Pose) -> Float[Tensor, "R o"]:
        """Code of each place."""
        like = next(self.network.parameters()).dtype
        position = (place.position - self.center).to(like) / self.scale_m
        waves = torch.cat([math.pi * 2**octave * position for octave in range(OCTAVES)], -1)
        seen = torch.cat(
            [position, waves.sin(), waves.cos(), direction(place.heading.to(like))], -1
        )
        known = place.known
        if self.training:
            known = known & (torch.rand(known.shape, device=known.device) >= self.dropout)
        return torch.where(known.unsqueeze(-1), self.network(seen), 0.0)
