"""States and controls as columns: elementwise operations are fast along the last dimension."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Columns(NamedTuple):
    """A batch of states and controls, side by side; n is the product of its leading dimensions."""

    state: Float[Tensor, "c n"]
    control: Float[Tensor, "m n"]
    shape: torch.Size  # the leading dimensions

    def as_rows(self, columns: Float[Tensor, "c n"]) -> Float[Tensor, "*b c"]:
        """Results laid out like any state, so that a compiled step has one graph."""
        return columns.mT.reshape(*self.shape, columns.shape[0]).contiguous()


def side_by_side(state: Float[Tensor, "*#b c"], control: Float[Tensor, "*#b m"]) -> Columns:
    """Columns of states and controls, whose leading dimensions are broadcast and put last."""
    shape = torch.broadcast_shapes(state.shape[:-1], control.shape[:-1])
    return Columns(_flat(state, shape), _flat(control, shape), shape)


def _flat(rows: Float[Tensor, "*b c"], shape: torch.Size) -> Float[Tensor, "c n"]:
    return rows.expand(*shape, rows.shape[-1]).reshape(-1, rows.shape[-1]).mT.contiguous()
