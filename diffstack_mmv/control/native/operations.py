"""What each core tensor operation is in scalars."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch

from diffstack_mmv.control.native.lowering import CannotLowerError, Entries, Lowering
from diffstack_mmv.control.native.scalar import FOLDS
from diffstack_mmv.control.native.views import VIEWS, as_list

Handler = Callable[..., Any]


def _direct(name: str) -> Handler:
    def handler(low: Lowering, *arguments: Any, **_: Any) -> Entries:
        return low.map(name, *(low.numbers(argument) for argument in arguments))

    return handler


def _scaled(name: str) -> Handler:
    """Addition and subtraction, whose second argument may have a factor."""

    def handler(low: Lowering, a: Any, b: Any, alpha: float = 1, **_: Any) -> Entries:
        second = low.numbers(b) if alpha == 1 else low.map("mul", low.numbers(b), alpha)
        return low.map(name, low.numbers(a), second)

    return handler


def _div(low: Lowering, a: Any, b: Any, rounding_mode: str | None = None) -> Entries:
    quotient = low.map("div", low.numbers(a), low.numbers(b))
    if rounding_mode is None:
        return quotient
    if rounding_mode != "floor":
        raise CannotLowerError(f"division with rounding_mode={rounding_mode}")
    return low.map("floor", quotient)


def _remainder(low: Lowering, a: Any, b: Any) -> Entries:
    """That of a division rounded down: it has the sign of the divisor."""
    rest = low.map("fmod", low.numbers(a), low.numbers(b))
    other_sign = low.map("lt", low.map("mul", rest, b), 0.0)
    return low.map("where", other_sign, low.map("add", rest, b), rest)


def _atanh(low: Lowering, a: Any) -> Entries:
    twice = low.map("sub", low.map("log1p", a), low.map("log1p", low.map("neg", a)))
    return low.map("mul", twice, 0.5)


def _scalar(low: Lowering, value: float, **_: Any) -> Entries:
    return low.constants(value)


def _pow(low: Lowering, base: Any, exponent: Any) -> Entries:
    base = low.numbers(base)
    if isinstance(exponent, int | float) and exponent in _POWERS:
        return _POWERS[exponent](low, base)
    return low.map("pow", base, low.numbers(exponent))


def _square(low: Lowering, a: Any) -> Entries:
    return low.map("mul", a, a)


def _reciprocal(low: Lowering, a: Any) -> Entries:
    return low.map("div", 1.0, low.numbers(a))


def _rsqrt(low: Lowering, a: Any) -> Entries:
    return _reciprocal(low, low.map("sqrt", low.numbers(a)))


_POWERS: dict[float, Handler] = {
    0.5: lambda low, a: low.map("sqrt", a),
    1.0: lambda low, a: a,
    2.0: _square,
    3.0: lambda low, a: low.map("mul", _square(low, a), a),
    4.0: lambda low, a: _square(low, _square(low, a)),
    -0.5: _rsqrt,
    -1.0: _reciprocal,
    -2.0: lambda low, a: _reciprocal(low, _square(low, a)),
}


def _where(low: Lowering, condition: Any, a: Any, b: Any) -> Entries:
    truths = low.truths(condition)
    return low.map("where", truths, a, b)


def _logical(name: str) -> Handler:
    def handler(low: Lowering, *arguments: Any) -> Entries:
        return low.map(name, *(low.truths(argument) for argument in arguments))

    return handler


def _clamp(low: Lowering, a: Any, least: Any = None, most: Any = None) -> Entries:
    """What is no number stays so, and a bound itself counts as inside of it."""
    if least is not None:
        a = low.map("where", low.map("lt", a, least), least, a)
    if most is not None:
        a = low.map("where", low.map("gt", a, most), most, a)
    return low.entries(a)


def _relu(low: Lowering, a: Any) -> Entries:
    return low.map("where", low.map("le", a, 0.0), 0.0, a)


def _below_and_small(low: Lowering, a: Any) -> tuple[Entries, Entries]:
    """Whether a number is below zero, and exp(-|a|): exp(a) overflows, and 0 · inf is no slope."""
    below = low.map("lt", a, 0.0)
    return below, low.map("exp", low.map("where", below, a, low.map("neg", a)))


def _sigmoid(low: Lowering, a: Any) -> Entries:
    below, small = _below_and_small(low, a)
    return low.map("div", low.map("where", below, small, 1.0), low.map("add", 1.0, small))


def _softplus(low: Lowering, a: Any, beta: float = 1, threshold: float = 20) -> Entries:
    """At any size: where torch takes the number itself, the rest is below its last digit."""
    scaled = low.map("mul", low.numbers(a), beta)
    below, small = _below_and_small(low, scaled)
    above = low.map("where", below, 0.0, scaled)
    return low.map("div", low.map("add", above, low.map("log1p", small)), beta)


def _reduced(a: Entries, dims: Any, keepdim: bool, combine: Callable[[list[Any]], Any]) -> Entries:
    """Combine the entries along some dimensions, all if none are told."""
    rank = a.ndim
    chosen = range(rank) if dims is None or dims == [] else as_list(dims)
    axes = sorted(each % rank for each in chosen) if rank else []
    rest = [axis for axis in range(rank) if axis not in axes]
    # not left to numpy to find: it cannot where there is nothing, as without agents
    length = math.prod(a.shape[axis] for axis in axes)
    rows = a.transpose([*rest, *axes]).reshape([*(a.shape[axis] for axis in rest), length])
    result = np.empty(rows.shape[:-1], dtype=object)
    for index in np.ndindex(*result.shape):
        result[index] = combine(list(rows[index]))
    shape = [1 if axis in axes else a.shape[axis] for axis in range(rank)]
    return result.reshape(shape) if keepdim else result


def _sum(low: Lowering, a: Any, dims: Any = None, keepdim: bool = False, **_: Any) -> Entries:
    return _reduced(low.numbers(a), dims, keepdim, low.program.total)


def _mean(low: Lowering, a: Any, dims: Any = None, keepdim: bool = False, **_: Any) -> Entries:
    total = _sum(low, a, dims, keepdim)
    return low.map("div", total, float(a.size // max(total.size, 1)))


def _folded(name: str, low: Lowering, a: Any, dims: Any = None, keepdim: bool = False) -> Entries:
    def combine(nodes: list[Any]) -> Any:
        result = nodes[0]
        for node in nodes[1:]:
            result = low.program.apply(name, result, node)
        return result

    return _reduced(low.numbers(a), dims, keepdim, combine)


def _softmax(low: Lowering, a: Entries, dim: int, half: bool = False) -> Entries:
    rest = low.map("sub", a, _folded("max", low, a, dim, True))
    bells = low.map("exp", rest)
    return low.map("div", bells, _sum(low, bells, dim, True))


def _norm(low: Lowering, a: Any, order: Any = 2, dims: Any = None, keep: bool = False) -> Entries:
    if order not in (2, None):
        raise CannotLowerError(f"a norm of order {order}")
    return low.map("sqrt", _sum(low, _square(low, a), dims, keep))


def _matrix_product(low: Lowering, a: Entries, b: Entries) -> Entries:
    return _sum(low, low.map("mul", a[..., :, :, None], b[..., None, :, :]), [-2])


def _copy(low: Lowering, a: Any, dtype: Any = None, **_: Any) -> Entries:
    if dtype is not None and dtype.is_floating_point:
        return low.numbers(a)
    if dtype == torch.bool:
        return low.truths(a)
    return (
        a if dtype is None else low.constants([int(v) for v in low.values(a)]).reshape(np.shape(a))
    )


def _cumsum(low: Lowering, a: Entries, dim: int, **_: Any) -> Entries:
    parts = list(np.moveaxis(low.numbers(a), dim, 0))
    for index in range(1, len(parts)):
        parts[index] = low.map("add", parts[index - 1], parts[index])
    return np.stack(parts, dim)


OWN = frozenset({"add", "sub", "div", "pow", "where", "max", "min", "and", "or", "not"})
"""Scalar operations that tensors do in another way, or under another name."""

HANDLERS: dict[str, Handler] = {
    **{
        name: _direct(scalar)
        for name, scalar in {
            **{each: each for each in FOLDS if each not in OWN},
            "maximum": "max",
            "minimum": "min",
        }.items()
    },
    "add": _scaled("add"),
    "sub": _scaled("sub"),
    "div": _div,
    "remainder": _remainder,
    "atanh": _atanh,
    "scalar_tensor": _scalar,
    "pow": _pow,
    "square": _square,
    "reciprocal": _reciprocal,
    "rsqrt": _rsqrt,
    "sigmoid": _sigmoid,
    "softplus": _softplus,
    "relu": _relu,
    "clamp": _clamp,
    "clamp_min": _clamp,
    "clamp_max": lambda low, a, most: _clamp(low, a, None, most),
    "where": _where,
    **{
        f"{kind}_{name}": _logical(name)
        for kind in ("bitwise", "logical")
        for name in ("and", "or", "not")
    },
    "sum": _sum,
    "mean": _mean,
    "amax": partial(_folded, "max"),
    "amin": partial(_folded, "min"),
    "prod": partial(_folded, "mul"),
    "_softmax": _softmax,
    "linalg_vector_norm": _norm,
    "cumsum": _cumsum,
    "mm": _matrix_product,
    "bmm": _matrix_product,
    "_to_copy": _copy,
    **VIEWS,
}
