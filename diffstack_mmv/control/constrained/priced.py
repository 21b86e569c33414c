"""The cost with constraints in it, at given multipliers and penalties."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.constrained.constraint import ConstraintRows
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.selection import Batched, Joined

DEAREST = 1e30  # instead of an infinite price, whose product with nothing would be NaN


class Yielding(NamedTuple):
    """What rows press with, and how far they give way."""

    multipliers: Tensor
    slack: Tensor  # not negative


def yielding(
    raw: Float[Tensor, "*b T1 K"], penalty: Float[Tensor, "*b one one"], rows: ConstraintRows
) -> Yielding:
    """The first-order update of all rows from raw = ν + ρ g."""
    linear = rows.linear.clamp_max(DEAREST)
    parts = (each.split(list(rows.widths), -1) for each in (raw, linear, rows.quadratic))
    each = zip(*parts, rows.signed_functions, strict=True)
    found = [_yielding(own, price, slope, penalty, both) for own, price, slope, both in each]
    return Yielding(*(torch.cat(part, -1) for part in zip(*found, strict=True)))


def _yielding(
    raw: Tensor, linear: Tensor, quadratic: Tensor, penalty: Tensor, signed: bool
) -> Yielding:
    """Slack s = (raw - w₁)₊ / (w₂ + ρ) and ν = raw₊ - ρ s; an equality gives way both ways."""
    above = (raw - linear).clamp_min(0) / (quadratic + penalty)
    if not signed:
        return Yielding(raw.clamp_min(0) - penalty * above, above)
    below = (-raw - linear).clamp_min(0) / (quadratic + penalty)
    return Yielding(raw - penalty * (above - below), above + below)


def priced_cost(
    problem: Problem,
    multipliers: Float[Tensor, "B T1 K"],
    penalty: Float[Tensor, "B one one"],
) -> Batched:
    """The cost c + Σ (ν⁺² - ν²) / (2 ρ) + w₁ s + ½ w₂ s², with ν⁺ and s as in `yielding`."""
    rows = problem.rows
    parts = [_taken_apart(each) for each in (problem.cost, *rows.functions)]
    functions = [function for function, _ in parts]
    counts = [len(tensors) for _, tensors in parts]
    widths, signed = list(rows.widths), rows.signed_functions

    def cost(states: Tensor, controls: Tensor, *tensors: Tensor) -> Tensor:
        weight, own = tensors[3], tensors[4:]
        prices = zip(*(each.split(widths, -1) for each in tensors[:3]), strict=True)
        total, first = functions[0](states, controls, *own[: counts[0]]), counts[0]
        rest = zip(functions[1:], counts[1:], prices, signed, strict=True)
        for function, count, (before, linear, quadratic), both in rest:
            values = function(states, controls, *own[first : first + count])
            after = _yielding(before + weight * values, linear, quadratic, weight, both)
            paid = linear * after.slack + 0.5 * quadratic * after.slack.square()
            change = (after.multipliers.square() - before.square()) / (2 * weight)
            total, first = total + (change + paid).sum(-1), first + count
        return total

    given = multipliers, rows.linear.clamp_max(DEAREST), rows.quadratic, penalty
    own = [tensor for _, tensors in parts for tensor in tensors]
    return Joined(cost, functions, *given, *own)


def _taken_apart(function: Callable[..., Tensor]) -> tuple[Callable[..., Tensor], tuple]:
    if isinstance(function, Batched):
        return function.function, function.tensors
    return function, ()
