"""Random numbers that belong to a forecast, and not to its place in a batch."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.seeding import stream


def drawn_rows(
    shape: Sequence[int], draw: Callable[[torch.Generator], Tensor], seed: int, first: int
) -> Float[Tensor, "..."]:
    """Draw `*b *d` numbers with a generator for every forecast, so that scores know no batches.

    Args:
        shape: Leading dimensions *b of the forecasts.
        draw: What is drawn for each, `*d`.
        seed: Of all of them.
        first: Number of the first forecast among all that are judged; the others follow.
    """
    count = torch.Size(shape).numel()
    # one draw even for no forecast, which tells the shape
    numbers = range(first, first + max(count, 1))
    generators = (torch.Generator().manual_seed(stream(seed, number)) for number in numbers)
    drawn = torch.stack([draw(generator) for generator in generators])[:count]
    return drawn.reshape(*shape, *drawn.shape[1:])


def components_of(
    log_weight: Float[Tensor, "*b K"], share: Float[Tensor, "*b S"]
) -> Int[Tensor, "*b S"]:
    """Components at these shares, in [0, 1), of the sum of the weights; none without weight."""
    below = log_weight.exp().to("cpu", torch.float64).cumsum(-1)
    share = share.to(torch.float64).contiguous()
    return torch.searchsorted(below / below[..., -1:], share, right=True).to(log_weight.device)
