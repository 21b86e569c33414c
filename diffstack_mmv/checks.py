"""Checks of arguments at the border: constructors, configuration and files.

`message` and `require` tell all of them in one form, which the converters share.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from dmmv_conventions.checks import message, require


def require_positive(argument: str, value: float | int, where: str = "", remedy: str = "") -> None:
    """Refuse a number that is not finite and above zero.

    Raises:
        ValueError: `value` is zero, negative, infinite or NaN.
    """
    require(math.isfinite(value) and value > 0, argument, "be positive", value, where, remedy)


def require_at_least(
    argument: str, value: float | int, low: float | int, where: str = "", remedy: str = ""
) -> None:
    """Refuse a number below `low`.

    Raises:
        ValueError: `value` is below `low` or NaN.
    """
    require(value >= low, argument, f"be at least {low}", value, where, remedy)


def require_between(
    argument: str,
    value: float | int,
    low: float | int,
    high: float | int,
    where: str = "",
    remedy: str = "",
) -> None:
    """Refuse a number outside [low, high].

    Raises:
        ValueError: `value` lies outside the interval or is NaN.
    """
    require(low <= value <= high, argument, f"lie in [{low}, {high}]", value, where, remedy)


def require_one_of(argument: str, value: str, choices: Sequence[str], where: str = "") -> None:
    """Refuse a name that is not among the known ones.

    Raises:
        ValueError: `value` is not in `choices`.
    """
    require(
        value in choices, argument, f"be one of {', '.join(sorted(choices))}", repr(value), where
    )


def require_multiple(argument: str, value: float | int, step: float | int, where: str = "") -> int:
    """Return how many steps make up `value`.

    Raises:
        ValueError: `value` is not a whole number of steps.
    """
    require_positive(argument, value, where)
    steps = round(value / step)
    whole = steps >= 1 and math.isclose(steps * step, value, rel_tol=1e-6)
    require(
        whole,
        argument,
        f"be a multiple of {step}",
        value,
        where,
        f"Take {max(steps, 1) * step:g}, for example.",
    )
    return steps


def require_columns(argument: str, tensor: Tensor, columns: int, names: Sequence[str] = ()) -> None:
    """Refuse a tensor whose last dimension has another length.

    Raises:
        ValueError: The last dimension of `tensor` is not `columns`.
    """
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
