"""The recurrences of the predictor in a library, which takes blocks of rows through all steps.

On tensors every gate of every step is an operation of its own; in the library a block of rows stays
in the cache from the first step to the last. Only the states are kept for the backward pass.
"""

import ctypes
import functools
import logging
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.prediction.trajectron.recurrence import Weights
from dmmv_conventions.libraries import CannotBuildError, load, pointers
from dmmv_conventions.progress import waiting

LOGGER = logging.getLogger(__name__)
REALS = {torch.float32: "float", torch.float64: "double"}
LANES = {torch.float32: 16, torch.float64: 8}
"""Numbers of a vector."""


@dataclass(frozen=True)
class Blocks:
    """The recurrences in blocks of rows, for tensors on a CPU with a compiler."""

    def fit(self, like: Tensor) -> bool:
        """Whether rows like these can be taken."""
        plain = like.device.type == "cpu" and like.dtype in REALS and like.numel() > 0
        return plain and _library(like.dtype) is not None

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
        """
        last: Tensor = _Last.apply(features.contiguous(), valid.to(weight.dtype), weight)  # type: ignore[no-untyped-call]
        return last

    def emissions(
        self,
        constant: Float[Tensor, "N g"],
        hidden: Float[Tensor, "N h"],
        weights: Weights,
        steps: int,
    ) -> Float[Tensor, "N S e"]:
        """A GRU whose own emission is its input; see `recurrence.emissions`.

        Args:
            constant: The part of the input that does not change.
            hidden: First state.
            weights: Weights of gates and emissions.
            steps: Number S of steps.
        """
        emitted: Tensor = _Emissions.apply(constant, hidden, steps, *weights)  # type: ignore[no-untyped-call]
        return emitted


@functools.cache
def _library(dtype: torch.dtype) -> Any:
    """The library for numbers of a type, None where it cannot be built."""
    text = files("diffstack_mmv.prediction.trajectron").joinpath("recurrence.hpp").read_text()
    try:
        with waiting("compile the recurrences of the predictor"):
            return load(f"typedef {REALS[dtype]} Real;\n{text}", "-O3")
    except CannotBuildError as failure:
        LOGGER.info("No library for the recurrences of the predictor (%s): tensors", failure)
        return None


def _counts(*numbers: int) -> list[Any]:
    return [ctypes.c_long(number) for number in numbers]


def _places(*tensors: Tensor | None) -> list[Any]:
    return [None if each is None else pointers(each)[0] for each in tensors]


def _blocks(rows: int, like: Tensor) -> int:
    return -(-rows // (4 * LANES[like.dtype]))


def _kept(steps: int, units: int, rows: int, like: Tensor) -> Tensor:
    """Room for states, with whole blocks of rows last."""
    return like.new_empty(steps, units, _blocks(rows, like) * 4 * LANES[like.dtype])


def _slopes(rows: int, outputs: int, inputs: int, like: Tensor) -> Tensor:
    """Room for the slopes of weights, one matrix for each block, with whole vectors."""
    lanes = LANES[like.dtype]
    return like.new_empty(_blocks(rows, like), outputs, -(-inputs // lanes) * lanes)


class _Last(torch.autograd.Function):
    """`Blocks.last_states` with its gradient."""

    @staticmethod
    def forward(ctx: Any, features: Tensor, keep: Tensor, weight: Tensor) -> Tensor:
        (rows, steps, _), size = features.shape, len(weight) // 4
        last, kept = features.new_empty(rows, size), [None, None]
        if any(ctx.needs_input_grad):
            kept = [_kept(steps, size, rows, features) for _ in range(2)]
        given = features, keep.contiguous(), weight.contiguous()
        counts = _counts(rows, torch.get_num_threads(), *features.shape[1:], size)
        _library(weight.dtype).dmmv_lstm(*counts, *_places(*given, last, *kept))
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
        counts = _counts(rows, torch.get_num_threads(), *features.shape[1:], gates // 4)
        adjoint = _library(weight.dtype).dmmv_lstm_adjoint
        adjoint(*counts, *_places(*given, by_weight, by_features))
        return by_features, None, by_weight.sum(0)[:, :width]


class _Emissions(torch.autograd.Function):
    """`Blocks.emissions` with its gradient."""

    @staticmethod
    def forward(ctx: Any, constant: Tensor, hidden: Tensor, steps: int, *tensors: Tensor) -> Tensor:
        weights, (rows, size) = Weights(*(each.contiguous() for each in tensors)), hidden.shape
        result = hidden.new_empty(rows, steps, len(weights.head))
        kept = _kept(steps + 1, size, rows, hidden) if any(ctx.needs_input_grad) else None
        constant = constant.contiguous()
        call = _library(hidden.dtype).dmmv_gru
        given = constant, hidden.contiguous(), *weights, result, kept
        call(*_gru_counts(result, weights), *_places(*given))
        ctx.save_for_backward(constant, *weights, result, kept)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        constant, *tensors, result, kept = ctx.saved_tensors
        weights, rows = Weights(*tensors), len(result)
        size, fed, emitted = kept.shape[1], weights.control.shape[-1], len(weights.head)
        transposed = weights.control, weights.hidden.roll(size, 0), weights.head
        back = [each.T.contiguous() for each in transposed]
        by_constant, by_start = torch.empty_like(constant), grad.new_empty(rows, size)
        by_hidden = _slopes(rows, 3 * size, size, grad)
        sizes = 3 * size * fed, 4 * size, emitted * size, emitted
        others = grad.new_empty(len(by_hidden), sum(sizes))
        forward = constant, weights.control, weights.hidden, weights.hidden_bias
        found = by_constant, by_start, by_hidden, others
        call = _library(grad.dtype).dmmv_gru_adjoint
        given = *forward, *back, result, grad.contiguous(), kept, *found
        call(*_gru_counts(result, weights), *_places(*given))
        control, bias, head, head_bias = others.sum(0).split(sizes)
        slopes = Weights(
            control=control.unflatten(0, (-1, fed)),
            hidden=by_hidden.sum(0)[:, :size].roll(-size, 0),
            hidden_bias=bias[: 3 * size].roll(-size, 0),
            head=head.unflatten(0, (emitted, size)),
            head_bias=head_bias,
        )
        return by_constant, by_start, None, *slopes


def _gru_counts(result: Tensor, weights: Weights) -> list[Any]:
    rows, steps, emitted = result.shape
    size, fed = weights.hidden.shape[-1], weights.control.shape[-1]
    return _counts(rows, torch.get_num_threads(), steps, size, fed, emitted)
