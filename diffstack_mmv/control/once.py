"""Derivatives that say so when they are differentiated again: the answer would be wrong."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from diffstack_mmv.checks import message


def once(slopes: Sequence[Tensor | None], *sources: Tensor) -> list[Tensor | None]:
    """Slopes that refuse to be differentiated by what they were computed from.

    Args:
        slopes: What a backward pass returns.
        sources: What it depends on, with its graph.
    """
    if not torch.is_grad_enabled():  # nobody means to
        return list(slopes)
    return [None if slope is None else _Refusal.apply(slope, *sources) for slope in slopes]


class Once(torch.autograd.Function):
    """Tensors as they are, that can be differentiated once."""

    @staticmethod
    def forward(ctx: Any, *tensors: Tensor) -> tuple[Tensor, ...]:
        """The tensors."""
        ctx.save_for_backward(*tensors)
        return tuple(each.clone() for each in tensors)

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        """Their slopes."""
        return tuple(once(slopes, *ctx.saved_tensors))


class _Refusal(torch.autograd.Function):
    """A first derivative, which cannot be differentiated."""

    @staticmethod
    def forward(ctx: Any, slope: Tensor, *sources: Tensor) -> Tensor:
        """The derivative."""
        return slope.clone()

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        """Refuse.

        Raises:
            RuntimeError: Always.
        """
        raise RuntimeError(
            message(
                "solution",
                "be differentiated once",
                "a second derivative",
                remedy="Set gradient=Unrolled(), without compile=True and constraints.",
            )
        )
