"""Checks of arguments at the border: constructors, configuration and files.

Those of plain values are shared with the converters and the command lines; they need no tensor.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from dmmv_conventions.checks import (
    message,
    require,
    require_at_least,
    require_between,
    require_multiple,
    require_one_of,
    require_positive,
    require_switch,
    require_whole,
)

__all__ = [
    "message",
    "require",
    "require_at_least",
    "require_between",
    "require_callable",
    "require_columns",
    "require_finite",
    "require_multiple",
    "require_one_of",
    "require_positive",
    "require_precision",
    "require_switch",
    "require_tensor",
    "require_whole",
]


def require_tensor(argument: str, value: object) -> None:
    """Refuse anything but a tensor.

    Raises:
        TypeError: `value` is something else.
    """
    if not isinstance(value, Tensor):
        remedy = "Write torch.as_tensor(...) around it."
        found = type(value).__name__
        raise TypeError(message(argument, "be a tensor", found, "", remedy))


def require_precision(argument: str, dtype: torch.dtype, where: str = "", remedy: str = "") -> None:
    """Refuse anything but single and double precision.

    Half precision resolves a position of 5 m to 3 cm (bfloat16), and forces are beyond its range
    (float16).

    Raises:
        TypeError: `dtype` is another type.
    """
    if dtype not in (torch.float32, torch.float64):
        wanted = "be torch.float32 or torch.float64"
        raise TypeError(message(argument, wanted, dtype, where, remedy))


def require_callable(argument: str, value: object, remedy: str = "") -> None:
    """Refuse what cannot be called.

    Raises:
        TypeError: `value` is no function, method or module.
    """
    if not callable(value):
        found = type(value).__name__
        raise TypeError(message(argument, "be a function or a module", found, "", remedy))


def require_columns(argument: str, tensor: Tensor, columns: int, names: Sequence[str] = ()) -> None:
    """Refuse a tensor that has not the shape (..., columns).

    Raises:
        ValueError: The last dimension of `tensor` is not `columns`.
        TypeError: It is no tensor.
    """
    require_tensor(argument, tensor)
    told = f" ({', '.join(names)})" if names else ""
    if tensor.dim() == 0 or tensor.shape[-1] != columns:
        raise ValueError(
            message(
                argument,
                f"have {columns} columns{told} in its last dimension",
                f"shape {tuple(tensor.shape)}",
            )
        )


def require_finite(argument: str, tensor: Tensor, where: str = "", remedy: str = "") -> None:
    """Refuse a tensor with NaN or infinite entries.

    Raises:
        ValueError: Any entry of `tensor` is NaN or infinite.
    """
    bad = int((~torch.isfinite(tensor)).sum())
    require(
        bad == 0,
        argument,
        "be finite",
        f"{bad} of {tensor.numel()} entries NaN or infinite",
        where,
        remedy,
    )
