"""The recurrence of the decoder over time, with a backward pass written by hand.

Autograd would keep a dozen tensors per step and run one small operation after the other; here a
step backward is three matrix products and a few operations in place.
"""

import math
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.types import on_host

CHUNK = 640
"""Rows that a CPU takes through all steps at once: their state and gates stay in its cache."""


class Weights(NamedTuple):
    """Weights of the recurrence; the g = 3 h rows are those of reset, update and candidate."""

    control: Float[Tensor, "g m"]
    hidden: Float[Tensor, "g h"]
    hidden_bias: Float[Tensor, " g"]
    head: Float[Tensor, "e h"]  # the first m emissions are fed back
    head_bias: Float[Tensor, " e"]


class GRUStep(NamedTuple):
    """What the backward pass needs of one step."""

    before: Float[Tensor, "N h"]  # state the step starts from
    gates: Float[Tensor, "N g"]  # own part of the candidate, reset, update
    candidate: Float[Tensor, "N h"]


def emissions(
    constant: Float[Tensor, "N g"], hidden: Float[Tensor, "N h"], weights: Weights, steps: int
) -> Float[Tensor, "S N e"]:
    """Unroll a GRU whose own emission is its input.

        r, v = σ(c + W_u y + W_h h),    n = tanh(c + W_u y + r ∘ (W_h h + b))
        h⁺ = n + v ∘ (h - n),           e = W_e h⁺ + b_e,    y = first entries of e, 0 at first

    Can be differentiated once; a second derivative is refused. Computed in the precision of the
    weights, under autocast as well.

    Args:
        constant: c, the part of the input that does not change.
        hidden: First state.
        weights: Weights of gates and emissions.
        steps: Number S of steps.
    """
    with torch.autocast(hidden.device.type, enabled=False):
        kind = weights.hidden.dtype
        return _in_chunks(constant.to(kind), hidden.to(kind), weights, steps)


def _in_chunks(
    constant: Float[Tensor, "N g"], hidden: Float[Tensor, "N h"], weights: Weights, steps: int
) -> Float[Tensor, "S N e"]:
    """`emissions`, of so many rows at once as stay in the cache of a CPU."""
    tensors = (constant, hidden, *weights)
    learning = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    count = math.ceil(len(hidden) / CHUNK) if on_host(hidden) else 1
    rows = math.ceil(len(hidden) / max(count, 1)) or 1  # chunks of equal size
    chunks = [
        _Emissions.apply(*part, steps, *weights)  # type: ignore[no-untyped-call]
        if learning
        else _unrolled(*part, weights, steps, None)
        for part in zip(constant.split(rows), hidden.split(rows), strict=True)
    ]
    return chunks[0] if len(chunks) == 1 else torch.cat(chunks, 1)


def _reordered(rows: Tensor) -> Tensor:
    """Rows of candidate, reset, update from those of reset, update, candidate."""
    return rows.roll(len(rows) // 3, 0)


def _unrolled(
    constant: Float[Tensor, "N g"],
    hidden: Float[Tensor, "N h"],
    weights: Weights,
    steps: int,
    kept: list[GRUStep] | None,
) -> Float[Tensor, "S N e"]:
    """Emissions; `kept` receives what the backward pass needs.

    From the second step on, what is fed back is linear in the state, so that for reset and update
    it is a part of their weights.
    """
    size, fed = hidden.shape[-1], weights.control.shape[-1]
    fixed = constant + weights.hidden_bias
    fixed[:, 2 * size :] = weights.hidden_bias[2 * size :]
    fixed = _reordered(fixed.mT).mT.contiguous()
    back, back_bias = weights.head[:fed], weights.head_bias[:fed]
    matrix = _reordered(weights.hidden).mT.contiguous()
    result = hidden.new_empty(steps, len(hidden), len(weights.head))
    entering = constant[:, 2 * size :]
    for step in range(steps):
        gates = torch.addmm(fixed, hidden, matrix)
        own, both = gates[:, :size], gates[:, size:].sigmoid_()
        if step > 0:
            control = weights.control[2 * size :]
            entering = torch.addmm(constant[:, 2 * size :], result[step - 1, :, :fed], control.mT)
        candidate = torch.addcmul(entering, both[:, :size], own).tanh_()
        if kept is not None:
            kept.append(GRUStep(hidden, gates, candidate))
        hidden = torch.lerp(candidate, hidden, both[:, size:])
        torch.addmm(weights.head_bias, hidden, weights.head.mT, out=result[step])
        if step == 0:
            feedback = weights.control[: 2 * size]
            matrix[:, size:] += (feedback @ back).mT
            fixed[:, size:] += feedback @ back_bias
    return result


class _Emissions(torch.autograd.Function):
    """`emissions` with its gradient."""

    @staticmethod
    def forward(ctx: Any, constant: Tensor, hidden: Tensor, steps: int, *tensors: Tensor) -> Tensor:
        ctx.kept = []
        result = _unrolled(constant, hidden, Weights(*tensors), steps, ctx.kept)
        ctx.save_for_backward(*tensors, result)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        *tensors, result = ctx.saved_tensors
        constant, hidden, slopes = _pulled_back(grad, result, ctx.kept, Weights(*tensors))
        return constant, hidden, None, *slopes


def _pulled_back(
    grad: Float[Tensor, "S N e"],
    result: Float[Tensor, "S N e"],
    kept: list[GRUStep],
    weights: Weights,
) -> tuple[Tensor, Tensor, Weights]:
    """Gradients in the constant input, the first state and the weights."""
    rows, size = kept[0].candidate.shape
    fed = weights.control.shape[-1]
    matrix, control = _reordered(weights.hidden), weights.control
    total = Weights(*(torch.zeros_like(tensor) for tensor in weights))
    reordered, own_bias = torch.zeros_like(matrix), torch.zeros_like(total.hidden_bias[:size])
    constant = grad.new_zeros(rows, 3 * size)
    slope = grad.new_zeros(rows, size)
    # own part of the candidate, reset, update, entering part of the candidate: the first three
    # belong to the weights of the state, the last three to those of the input
    gates = grad.new_empty(rows, 4 * size)
    own, reset, update, entering = gates.split(size, -1)
    emitted = grad[-1].clone()
    after = None
    for step in range(len(kept) - 1, -1, -1):
        before, (own_value, reset_value, update_value), candidate = (
            kept[step].before,
            kept[step].gates.split(size, -1),
            kept[step].candidate,
        )
        after = torch.lerp(candidate, before, update_value) if after is None else after
        total.head.addmm_(emitted.mT, after)
        total.head_bias.add_(emitted.sum(0))
        slope.addmm_(emitted, weights.head)
        torch.sub(before, candidate, out=update).mul_(slope)
        torch.ops.aten.sigmoid_backward.grad_input(update, update_value, grad_input=update)
        passed = slope * update_value
        torch.ops.aten.tanh_backward.grad_input(slope - passed, candidate, grad_input=entering)
        torch.mul(entering, own_value, out=reset)
        torch.ops.aten.sigmoid_backward.grad_input(reset, reset_value, grad_input=reset)
        torch.mul(entering, reset_value, out=own)
        reordered.addmm_(gates[:, : 3 * size].mT, before)
        own_bias.add_(own.sum(0))
        constant.add_(gates[:, size:])
        slope = passed.addmm_(gates[:, : 3 * size], matrix)
        if step > 0:
            emitted = grad[step - 1].clone()
            emitted[:, :fed].addmm_(gates[:, size:], control)
            # a product with two rows is fast, one with two columns is not
            total.control.add_((result[step - 1, :, :fed].mT @ gates[:, size:]).mT)
        after = before
    total.hidden.copy_(reordered.roll(-size, 0))
    total.hidden_bias.copy_(torch.cat([constant.sum(0)[: 2 * size], own_bias]))
    return constant, slope, total
