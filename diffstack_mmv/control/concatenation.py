"""Keeps graphs of `torch.vmap` free of the sizes they were traced at."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode


class PaddedConcatenation(TorchFunctionMode):
    """Inside of it, `torch.cat` is a sum of padded tensors.

    The rule of `torch.vmap` for concatenation reads sizes as plain numbers, which would tie the
    graph of a callable that concatenates to one batch and horizon. Callables use `torch.cat`; the
    solver, whose own concatenations are outside of `vmap`, uses `torch.concatenate`.
    """

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Iterable[type],
        args: Sequence[Any] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Call `func`, or what replaces it."""
        replaced = func is torch.cat or func is torch.concat
        return (_concatenated if replaced else func)(*args, **(kwargs or {}))


def _concatenated(tensors: Sequence[Tensor], dim: int = 0) -> Tensor:
    rank = tensors[0].dim()
    axis = dim % rank
    total = sum(tensor.shape[axis] for tensor in tensors)
    parts, before = [], 0
    for tensor in tensors:
        after = total - before - tensor.shape[axis]
        padding = [0, 0] * (rank - 1 - axis) + [before, after]
        parts.append(torch.nn.functional.pad(tensor, padding))
        before = before + tensor.shape[axis]
    return sum(parts[1:], parts[0])
