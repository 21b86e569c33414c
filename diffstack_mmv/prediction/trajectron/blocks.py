"""The recurrences of the predictor in a library, which takes blocks of rows through all steps.

On tensors every gate of every step is an operation of its own; in the library a block of rows stays
in the cache from the first step to the last. Only the states are kept for the backward pass.
"""

import functools
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.checks import require
from diffstack_mmv.prediction.trajectron.recurrence import Weights
from diffstack_mmv.types import on_host
from dmmv_conventions.libraries import REALS, counts, header, load_or_tell, pointers
from dmmv_conventions.progress import waiting

HEADERS = "lanes", "memory", "decoder", "paths"
ROWS = {torch.float32: 64, torch.float64: 32}
"""Rows of a block."""


@dataclass(frozen=True)
class Scaling:
    """What the emissions of a decoder are multiples of.

    Args:
        width: Of the controls, in their units; without a gradient.
        log_range: A deviation stays within this factor of its value at zero, in logarithms.
        scale: Deviations at zero, in widths.
    """

    width: Float[Tensor, " m"]
    log_range: float
    scale: float

    def tensors(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Its numbers as a library reads them, (m,) and (2,)."""
        spans = like.new_tensor([self.log_range, self.scale])
        return self.width.detach().to(like.dtype).contiguous(), spans


@dataclass(frozen=True)
class Blocks:
    """The recurrences in blocks of rows, for tensors on a CPU with a compiler."""

    def fit(self, like: Tensor, *others: Tensor) -> bool:
        """Whether rows like these, of any shape, can be taken beside tensors of the same type."""
        plain = on_host(like, *others) and like.dtype in REALS and like.numel() > 0
        plain = plain and all(each.dtype == like.dtype for each in others)
        return plain and library(like.dtype) is not None

    def last_states(
        self,
        features: Float[Tensor, "R T f"],
        valid: Bool[Tensor, "R T"],
        weight: Float[Tensor, "g j"],
    ) -> Float[Tensor, "R h"]:
        """Last states of an LSTM; see `MaskedLSTM`.

        Args:
            features: Of each row at each time.
            valid: Where the state goes on.
            weight: Of inputs, one and state, beside each other.

        Raises:
            ValueError: Their sizes do not fit together.
        """
        (rows, steps, _), (gates, width) = features.shape, weight.shape
        _require_shape("features", features, rows, steps, width - 1 - gates // 4)
        _require_shape("valid", valid, rows, steps)
        last: Tensor = _Last.apply(features.contiguous(), valid.to(weight.dtype), weight)  # type: ignore[no-untyped-call]
        return last

    def controls(
        self,
        constant: Float[Tensor, "N g"],
        hidden: Float[Tensor, "N h"],
        base: Float[Tensor, "N T m"],
        weights: Weights,
        scaling: Scaling,
    ) -> tuple[Float[Tensor, "N T m"], Float[Tensor, "N T m m"]]:
        """Mean controls and Cholesky factors of their covariances; see `ControlDecoder`.

        Rows without a gradient are left out of the backward pass.

        Args:
            constant: The part of the input of the GRU that does not change.
            hidden: Its first state.
            base: Controls that the emissions are deviations from.
            weights: Weights of gates and emissions.
            scaling: What emissions are multiples of.

        Raises:
            ValueError: Their sizes do not fit together.
        """
        (rows, size), (_, steps, m) = hidden.shape, base.shape
        emitted = m + m * (m + 1) // 2
        _require_shape("constant", constant, rows, 3 * size)
        _require_shape("base", base, rows, steps, m)
        _require_shape("weights.control", weights.control, 3 * size, m)
        _require_shape("weights.hidden", weights.hidden, 3 * size, size)
        _require_shape("weights.hidden_bias", weights.hidden_bias, 3 * size)
        _require_shape("weights.head", weights.head, emitted, size)
        _require_shape("weights.head_bias", weights.head_bias, emitted)
        _require_shape("scaling.width", scaling.width, m)
        found: tuple[Tensor, Tensor] = _Controls.apply(  # type: ignore[no-untyped-call]
            constant, hidden, base, scaling, *weights
        )
        return found


@functools.cache
def library(dtype: torch.dtype) -> Any:
    """The library for numbers of a type, None where it cannot be built."""
    own = (header("diffstack_mmv.prediction.trajectron", name) for name in HEADERS)
    parts = f"typedef {REALS[dtype]} Real;", header("dmmv_conventions", "threads"), *own
    with waiting("compile the recurrences of the predictor"):
        return load_or_tell("the recurrences of the predictor", "\n".join(parts), "-O3")


def _require_shape(name: str, tensor: Tensor, *shape: int) -> None:
    """Refuse a tensor of which a library would read what is not there.

    Raises:
        ValueError: It has another shape.
    """
    found = tuple(tensor.shape)
    require(found == shape, name, f"have the shape {shape}", found)


def _blocks(rows: int, like: Tensor) -> int:
    return -(-rows // ROWS[like.dtype])


def _whole(units: int, like: Tensor) -> int:
    """So many units filled up to whole vectors of this processor."""
    lanes: int = library(like.dtype).dmmv_lanes()
    return -(-units // lanes) * lanes


def _kept(steps: int, units: int, rows: int, like: Tensor) -> Tensor:
    """Room for states of whole blocks of rows."""
    return like.new_empty(_blocks(rows, like), steps, units, ROWS[like.dtype])


def _slopes(rows: int, outputs: int, inputs: int, like: Tensor) -> Tensor:
    """Room for the slopes of weights, one matrix for each block, with whole vectors."""
    return like.new_empty(_blocks(rows, like), outputs, _whole(inputs, like))


class _Last(torch.autograd.Function):
    """`Blocks.last_states` with its gradient."""

    @staticmethod
    def forward(ctx: Any, features: Tensor, keep: Tensor, weight: Tensor) -> Tensor:
        (rows, steps, _), size = features.shape, len(weight) // 4
        last, kept = features.new_empty(rows, size), [None, None]
        if any(ctx.needs_input_grad):
            kept = [_kept(steps, size, rows, features) for _ in range(2)]
        given = features, keep.contiguous(), weight.contiguous()
        sizes_ = counts(rows, torch.get_num_threads(), *features.shape[1:], size)
        library(weight.dtype).dmmv_lstm(*sizes_, *pointers(*given, last, *kept))
        ctx.save_for_backward(*given, *kept)
        return last

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, None, Tensor]:
        features, keep, weight, *kept = ctx.saved_tensors
        (rows, _, _), (gates, width) = features.shape, weight.shape
        by_weight = _slopes(rows, gates, width, weight)
        by_features = torch.empty_like(features) if ctx.needs_input_grad[0] else None
        given = features, keep, weight, weight.T.contiguous(), grad.contiguous(), *kept
        sizes_ = counts(rows, torch.get_num_threads(), *features.shape[1:], gates // 4)
        adjoint = library(weight.dtype).dmmv_lstm_adjoint
        adjoint(*sizes_, *pointers(*given, by_weight, by_features))
        return by_features, None, by_weight.sum(0)[:, :width]


class _Controls(torch.autograd.Function):
    """`Blocks.controls` with its gradient."""

    @staticmethod
    def forward(
        ctx: Any, constant: Tensor, hidden: Tensor, base: Tensor, scaling: Scaling, *tensors: Tensor
    ) -> tuple[Tensor, Tensor]:
        weights = Weights(*(each.contiguous() for each in tensors))
        given = constant.contiguous(), hidden.contiguous(), base.contiguous()
        (rows, size), (*_, steps, controls) = hidden.shape, base.shape
        ctx.counts = rows, steps, size, controls
        kept, (width, spans) = None, scaling.tensors(hidden)
        if any(ctx.needs_input_grad):
            whole = _blocks(rows, hidden) * ROWS[hidden.dtype]
            kept = hidden.new_empty(whole, steps + 1, _whole(size, hidden))
        found = torch.empty_like(given[2]), hidden.new_empty(rows, steps, controls, controls)
        sizes_ = counts(rows, torch.get_num_threads(), *ctx.counts[1:])
        each = *given, *weights, width, spans, *found, kept
        library(hidden.dtype).dmmv_controls(*sizes_, *pointers(*each))
        ctx.save_for_backward(given[0], *weights, width, spans, kept)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        constant, *tensors, width, spans, kept = ctx.saved_tensors
        weights, by_controls = Weights(*tensors), grads[0].contiguous()
        rows, _, size, fed = ctx.counts
        emitted = len(weights.head)
        transposed = weights.control, weights.hidden.roll(size, 0), weights.head
        back = [each.T.contiguous() for each in transposed]
        by_constant, by_start = torch.empty_like(constant), constant.new_empty(rows, size)
        by_hidden = _slopes(rows, 3 * size, size, constant)
        sizes = 3 * size * fed, 4 * size, emitted * size, emitted
        others = constant.new_empty(len(by_hidden), sum(sizes))
        given = constant, *weights, width, spans, *back, kept, by_controls, grads[1].contiguous()
        sizes_ = counts(rows, torch.get_num_threads(), *ctx.counts[1:])
        found = by_constant, by_start, by_hidden, others
        live = library(constant.dtype).dmmv_controls_adjoint(*sizes_, *pointers(*given, *found))
        control, bias, head, head_bias = others[:live].sum(0).split(sizes)
        slopes = Weights(
            control=control.unflatten(0, (-1, fed)),
            hidden=by_hidden[:live].sum(0)[:, :size].roll(-size, 0),
            hidden_bias=bias[: 3 * size].roll(-size, 0),
            head=head.unflatten(0, (emitted, size)),
            head_bias=head_bias,
        )
        return by_constant, by_start, by_controls, None, *slopes
