"""Keeps graphs of `torch.vmap` polymorphic in the shapes they were traced at."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode


class ShapePolymorphic(TorchFunctionMode):
    """Inside of it, callables may concatenate and slice without tying a graph to one batch.

    The rules of `torch.vmap` for concatenation, and for the derivative of an index, read sizes as
    plain numbers: the graph would serve one batch and horizon. Here `torch.cat` is a sum of padded
    tensors, a slice of a short row (states[..., :2]) is a stack of its entries, and an index that
    only inserts dimensions (position[..., None, :]) inserts them one by one. Callables use
    `torch.cat`; the solver, whose own concatenations are outside of `vmap`, `torch.concatenate`.
    The body of a loop over time is traced without it: a step of the dynamics stacks its columns.

    Args:
        longest: Length up to which a last dimension is a row of states or controls, not a horizon.
    """

    def __init__(self, longest: int) -> None:
        super().__init__()
        self.longest = longest

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Iterable[type],
        args: Sequence[Any] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Call `func`, or what replaces it."""
        if func is torch.cat or func is torch.concat:
            return _concatenated(*args, **(kwargs or {}))
        if func is torch.Tensor.__getitem__ and _cuts_last(*args):
            tensor, index = args
            if tensor.shape[-1] <= self.longest:
                return _cut(tensor, index)
        if func is torch.Tensor.__getitem__ and _only_inserts(args[1]):
            return _inserted(*args)
        return func(*args, **(kwargs or {}))


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


def _cuts_last(tensor: Tensor, index: Any) -> bool:
    """Whether the index is (..., slice)."""
    is_pair = isinstance(index, tuple) and len(index) == 2
    return is_pair and index[0] is Ellipsis and isinstance(index[1], slice) and tensor.dim() > 0


def _cut(tensor: Tensor, index: tuple[Any, slice]) -> Tensor:
    kept = tensor.unbind(-1)[index[1]]
    return torch.stack(kept, -1) if kept else tensor.narrow(-1, 0, 0)


def _only_inserts(index: Any) -> bool:
    """Whether the index is (..., None or :, None or :)."""
    if not isinstance(index, tuple) or index[0] is not Ellipsis:
        return False
    return all(entry is None or _is_everything(entry) for entry in index[1:])


def _is_everything(entry: Any) -> bool:
    """Whether an entry of an index is a colon; a tensor in its place cannot be compared."""
    return isinstance(entry, slice) and (entry.start, entry.stop, entry.step) == (None, None, None)


def _inserted(tensor: Tensor, index: tuple[Any, ...]) -> Tensor:
    for after, entry in enumerate(reversed(index[1:])):
        if entry is None:
            tensor = tensor.unsqueeze(-1 - after)
    return tensor
