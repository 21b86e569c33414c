"""How torch writes its operations in core ones, with a form of our own where that one is worse.

What is differentiated here is the core form itself, twice. So it has to have the slope and the
curvature of the operation: |a|·|a| has none at zero, where a·a has.
"""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

REDUCTIONS: tuple[Callable[[Tensor], Tensor], ...] = (lambda each: each, torch.mean, torch.sum)
"""What is made of the losses of all entries, by torch's number for it."""


def huber_loss(
    value: Float[Tensor, "*#b"],
    target: Float[Tensor, "*#b"],
    reduction: int = 1,
    delta: float = 1.0,
) -> Tensor:
    """Half of the square up to `delta`, from there on `delta` times the distance."""
    rest = value - target
    size = rest.abs()
    far = delta * (size - 0.5 * delta)
    return REDUCTIONS[reduction](torch.where(size < delta, 0.5 * rest.square(), far))


def smooth_l1_loss(
    value: Float[Tensor, "*#b"],
    target: Float[Tensor, "*#b"],
    reduction: int = 1,
    beta: float = 1.0,
) -> Tensor:
    """The Huber loss over `beta`, and the distance itself where that is zero."""
    if beta == 0:
        return REDUCTIONS[reduction]((value - target).abs())
    return huber_loss(value, target, reduction, beta) / beta


def log_sigmoid(value: Float[Tensor, "*b"]) -> tuple[Tensor, Tensor]:
    """-softplus(-a), and what torch keeps for its own derivative: nothing."""
    return -torch.nn.functional.softplus(-value), value.new_zeros(0)


def decompositions() -> dict[Any, Any]:
    """The table of core forms."""
    from torch._decomp import core_aten_decompositions

    aten = torch.ops.aten
    table: Any = core_aten_decompositions()
    # exp(a) overflows in the branch that is not taken
    kept = {name: how for name, how in table.items() if name != aten.softplus.default}
    return kept | {
        aten.huber_loss.default: huber_loss,
        aten.smooth_l1_loss.default: smooth_l1_loss,
        aten.log_sigmoid_forward.default: log_sigmoid,
    }
