"""Priors of physical parameters."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Generator, Tensor


@dataclass(frozen=True)
class Prior:
    """Prior of the physical values: one entry per learned number.

    Args:
        mean: Prior value in its unit.
        std: Standard deviation in its unit: a quarter of the range.
        low: Lower end of the range.
        high: Upper end.
    """

    mean: Float[Tensor, " p"]
    std: Float[Tensor, " p"]
    low: Float[Tensor, " p"]
    high: Float[Tensor, " p"]

    def draw_values(self, generator: Generator, spread: float = 1.0) -> Float[Tensor, " p"]:
        """Values drawn uniformly from the mean ± `spread` deviations, inside the range.

        Args:
            generator: Of the random numbers.
            spread: Half width of the interval in standard deviations.
        """
        share = 2 * torch.rand(len(self.mean), generator=generator, dtype=self.mean.dtype) - 1
        margin = 0.02 * (self.high - self.low)
        drawn = self.mean + spread * share * self.std
        return torch.minimum(torch.maximum(drawn, self.low + margin), self.high - margin)
