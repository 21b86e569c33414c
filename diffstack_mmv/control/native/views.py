"""Operations that rearrange the entries of tensors, or make constant ones."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from diffstack_mmv.control.native.lowering import CannotLowerError, Entries, Lowering


def _slice(
    low: Lowering,
    a: Entries,
    dim: int = 0,
    start: int | None = None,
    end: int | None = None,
    step: int = 1,
) -> Entries:
    cut: list[Any] = [slice(None)] * a.ndim
    cut[dim] = slice(start, end, step)
    return a[tuple(cut)]


def _select(low: Lowering, a: Entries, dim: int, index: int) -> Entries:
    return np.asarray(a.take(index, dim), dtype=object)


def _item(low: Lowering, parts: Sequence[Entries], index: int) -> Entries:
    return parts[index]


def _unsqueeze(low: Lowering, a: Entries, dim: int) -> Entries:
    return np.expand_dims(a, dim)


def _squeeze(low: Lowering, a: Entries, dims: Any = None) -> Entries:
    chosen = range(a.ndim) if dims is None else [each % a.ndim for each in as_list(dims)]
    return a.squeeze(tuple(axis for axis in chosen if a.shape[axis] == 1))


def _expand(low: Lowering, a: Entries, shape: Sequence[int], **_: Any) -> Entries:
    old = (1,) * (len(shape) - a.ndim) + a.shape
    wanted = [had if want == -1 else want for want, had in zip(shape, old, strict=True)]
    return np.broadcast_to(a, wanted)


def _cat(low: Lowering, parts: Sequence[Entries], dim: int = 0) -> Entries:
    return np.concatenate([part for part in parts if part.shape != (0,)], dim)


def _stack(low: Lowering, parts: Sequence[Entries], dim: int = 0) -> Entries:
    return np.stack(parts, dim)


def _unbind(low: Lowering, a: Entries, dim: int = 0) -> list[Entries]:
    return [_select(low, a, dim, index) for index in range(a.shape[dim])]


def _split(low: Lowering, a: Entries, sizes: Any, dim: int = 0) -> list[Entries]:
    cuts = (
        np.cumsum(sizes)[:-1]
        if isinstance(sizes, list | tuple)
        else range(sizes, a.shape[dim], sizes)
    )
    return np.split(a, list(cuts), dim)


def _pad(low: Lowering, a: Entries, padding: Sequence[int], value: float = 0) -> Entries:
    widths = [(0, 0)] * a.ndim
    for axis, pair in enumerate(zip(padding[::2], padding[1::2], strict=True)):
        widths[a.ndim - 1 - axis] = pair
    if any(low_ < 0 or high < 0 for low_, high in widths):
        raise CannotLowerError("padding by less than nothing")
    sizes = [before + size + after for (before, after), size in zip(widths, a.shape, strict=True)]
    result = filled(float(value or 0), low, sizes)
    result[
        tuple(slice(first, first + size) for (first, _), size in zip(widths, a.shape, strict=True))
    ] = a
    return result


def _index_select(low: Lowering, a: Entries, dim: int, index: Entries) -> Entries:
    return a.take([int(value) for value in low.values(index)], dim)


def _index(low: Lowering, a: Entries, indices: Sequence[Entries | None]) -> Entries:
    chosen = tuple(
        slice(None) if each is None else np.array(low.values(each), dtype=int).reshape(each.shape)
        for each in indices
    )
    return a[chosen]


def _gather(low: Lowering, a: Entries, dim: int, index: Entries, **_: Any) -> Entries:
    chosen = np.array(low.values(index), dtype=int).reshape(index.shape)
    return np.take_along_axis(a, chosen, dim)


def _like(value: float | None, low: Lowering, a: Any, fill: float = 0.0, **_: Any) -> Entries:
    return np.full(np.shape(a), low.program.constant(fill if value is None else value), object)


def filled(value: float | None, low: Lowering, shape: Any, fill: Any = 0.0, **_: Any) -> Entries:
    """Entries that are all the same."""
    return np.full(shape, low.program.constant(fill if value is None else value), object)


def _arange(low: Lowering, start: float, end: float, step: float = 1, **_: Any) -> Entries:
    return low.constants(np.arange(start, end, step).tolist())


def _permute(low: Lowering, a: Entries, order: Sequence[int]) -> Entries:
    return a.transpose(order)


def _transpose(low: Lowering, a: Entries, first: int, second: int) -> Entries:
    return a.swapaxes(first, second)


def _view(low: Lowering, a: Entries, shape: Sequence[int]) -> Entries:
    return a.reshape(shape)


def _flip(low: Lowering, a: Entries, dims: Sequence[int]) -> Entries:
    return np.flip(a, dims)


def _reflect(low: Lowering, a: Any, *_: Any, **__: Any) -> Any:
    return a


def as_list(value: Any) -> list[int]:
    """Dimensions, told as one or as several."""
    return list(value) if isinstance(value, list | tuple) else [value]


VIEWS: dict[str, Callable[..., Any]] = {
    "slice": _slice,
    "select": _select,
    "<built-in function getitem>": _item,
    "unsqueeze": _unsqueeze,
    "squeeze": _squeeze,
    "expand": _expand,
    "cat": _cat,
    "stack": _stack,
    "unbind": _unbind,
    "split": _split,
    "split_with_sizes": _split,
    "constant_pad_nd": _pad,
    "index_select": _index_select,
    "index": _index,
    "gather": _gather,
    "full_like": partial(_like, None),
    "zeros_like": partial(_like, 0.0),
    "ones_like": partial(_like, 1.0),
    "full": partial(filled, None),
    "zeros": partial(filled, 0.0),
    "ones": partial(filled, 1.0),
    "arange": _arange,
    "permute": _permute,
    "transpose": _transpose,
    "view": _view,
    "reshape": _view,
    "_unsafe_view": _view,
    "flip": _flip,
    **dict.fromkeys(("clone", "alias", "detach", "lift_fresh_copy", "contiguous"), _reflect),
}
