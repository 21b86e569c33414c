"""Which rows of a batch are computed: those of a mask alone, or all and then masked.

To gather rows the host has to know how many they are. A CPU knows; a GPU would have to finish all
queued work first, which takes longer than computing rows that nobody wants.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.types import on_host


class ChosenRows(NamedTuple):
    """Rows that are computed, and which of them count."""

    index: Int[Tensor, " S"]
    kept: Bool[Tensor, " S"] | None  # None: all of them

    def put(
        self, into: Float[Tensor, "R ..."], values: Float[Tensor, "S ..."]
    ) -> Float[Tensor, "R ..."]:
        """Replace the rows that count by values."""
        if self.kept is not None:
            kept = self.kept.reshape(-1, *(1,) * (values.dim() - 1))
            values = torch.where(kept, values, into[self.index])
        return into.index_copy(0, self.index, values)


def chosen(mask: Bool[Tensor, " R"], among: Int[Tensor, " S"] | None = None) -> ChosenRows:
    """Rows of a mask.

    Args:
        mask: The rows that count.
        among: Rows outside of which the mask is False, where that is known without looking.
    """
    if on_host(mask):
        return ChosenRows(mask.nonzero().squeeze(-1), None)
    index = torch.arange(len(mask), device=mask.device) if among is None else among
    return ChosenRows(index, mask[index])
