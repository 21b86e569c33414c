"""The augmented Lagrangian of rows of constraints, as one more cost.

With the multiplier λ and the penalty ρ of the present outer iteration a row adds to the cost

    ψ(g) = max_ν  ν g - p*(ν) - (ν - λ)² / 2ρ

where p* is the conjugate of the price of a violation. For a hard inequality p* is zero on ν ≥ 0,
and ψ is the usual (max(0, λ + ρ g)² - λ²) / 2ρ. The maximiser ν is the next multiplier.

Source: Rockafellar, The multiplier method of Hestenes and Powell applied to convex programming,
JOTA 12, 1973; Howell et al., ALTRO, IROS 2019, for trajectories.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.constrained.constraint import Rows, joined
from diffstack_mmv.control.optimizer import Cost
from diffstack_mmv.control.selection import Batched, is_shared


def next_multiplier(
    raw: Float[Tensor, "*b T1 K"],
    penalty: Float[Tensor, "*#b #T1 K"],
    linear: Float[Tensor, "*b T1 K"],
    quadratic: Float[Tensor, "*b T1 K"],
    signed: Bool[Tensor, " K"],
) -> tuple[Float[Tensor, "*b T1 K"], Float[Tensor, "*b T1 K"]]:
    """The maximiser ν from raw = λ + ρ g, and by how much it exceeds the linear price."""
    low = torch.where(signed, -linear, torch.zeros_like(linear))
    share = quadratic / (quadratic + penalty)
    above = (raw - linear).relu() * share
    below = torch.where(signed, (-raw - linear).relu(), torch.zeros_like(raw)) * share
    return raw.clamp(low, linear) + above - below, above + below


def augmentation(
    values: Float[Tensor, "*b T1 K"],
    multipliers: Float[Tensor, "*b T1 K"],
    penalty: Float[Tensor, "*#b #T1 K"],
    linear: Float[Tensor, "*b T1 K"],
    quadratic: Float[Tensor, "*b T1 K"],
    signed: Bool[Tensor, " K"],
) -> Float[Tensor, "*b T1"]:
    """Σ ψ(g) of each time."""
    raw = multipliers + penalty * values
    following, excess = next_multiplier(raw, penalty, linear, quadratic, signed)
    weight = torch.where(quadratic > 0, 0.5 / quadratic, torch.zeros_like(quadratic))
    moved = (following - multipliers).square() / (2 * penalty)
    return (following * values - moved - weight * excess.square()).sum(-1)


def augmented(
    cost: Cost,
    rows: Rows,
    multipliers: Float[Tensor, "*b T1 K"],
    penalty: Float[Tensor, "*b 1 K"],
) -> Cost:
    """The cost with the augmented Lagrangian; selectable if all its parts are."""
    callables = (cost, *rows.functions)
    selectable = all(isinstance(part, Batched) or is_shared(part) for part in callables)
    parts, hidden = opened(callables) if selectable else (callables, ())
    signed, applies = rows.signed, rows.applies

    def total(states: Tensor, controls: Tensor, *tensors: Tensor) -> Tensor:
        own, rest = tensors[:4], tensors[4:]
        closed_cost, *functions = closed(parts, rest) if selectable else parts
        values = joined(functions, states, controls) * applies.to(states)
        return closed_cost(states, controls) + augmentation(values, *own, signed)

    own = (multipliers, penalty, rows.linear, rows.quadratic)
    if selectable:
        return Batched(total, *own, *hidden)
    return lambda states, controls: total(states, controls, *own)


def opened(callables: Sequence[Any]) -> tuple[tuple[Any, ...], tuple[Tensor, ...]]:
    """Pairs of function and number of its tensors, and the tensors of all of them."""
    pairs = [
        (part.function, part.tensors) if isinstance(part, Batched) else (part, ())
        for part in callables
    ]
    hidden = tuple(tensor for _, tensors in pairs for tensor in tensors)
    return tuple((function, len(tensors)) for function, tensors in pairs), hidden


def closed(parts: Sequence[Any], hidden: Sequence[Tensor]) -> list[Callable[..., Tensor]]:
    """Inverse of `opened`, around tensors that may be those of a selection."""
    functions, first = [], 0
    for function, count in parts:
        functions.append(Batched(function, *hidden[first : first + count]))
        first += count
    return functions
