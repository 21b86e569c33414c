"""An LSTM over tracks with gaps, with a backward pass written by hand."""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from diffstack_mmv.prediction.trajectron.blocks import Blocks
from diffstack_mmv.types import on_host


class LSTMStep(NamedTuple):
    """What the backward pass needs of one row of time."""

    memory: Float[Tensor, "h R"]  # before the step
    gates: Float[Tensor, "g R"]  # input, forget, candidate, output
    squashed: Float[Tensor, "h R"]  # tanh of the memory after the step


class MaskedLSTM(nn.Module):
    """LSTM that keeps its state over rows that are not valid, whatever they hold.

    Can be differentiated once; a second derivative is refused. Computed in the precision of the
    weights, under autocast as well; on a GPU in that of the LSTM there (`torch.backends.cudnn`).

    Args:
        inputs: Number of features of a row.
        hidden: Size of the state.
    """

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.cell = nn.LSTMCell(inputs, hidden)
        self.blocks: Blocks | None = None

    def compile_kernels(self) -> None:
        """Take the rows through all steps in one call from now on, where that is possible."""
        self.blocks = Blocks()

    def forward(
        self, features: Float[Tensor, "R T f"], valid: Bool[Tensor, "R T"]
    ) -> Float[Tensor, "R h"]:
        """Return the state after the last row, zero where no row is valid."""
        bias = self.cell.bias_ih + self.cell.bias_hh
        weight = torch.cat([self.cell.weight_ih, bias.unsqueeze(-1), self.cell.weight_hh], -1)
        with torch.autocast(features.device.type, enabled=False):
            rows = features.to(weight.dtype)
            if self.blocks is not None and self.blocks.fit(rows, weight):
                return self.blocks.last_states(rows, valid, weight)
            seen = torch.where(valid.unsqueeze(-1), rows, torch.zeros_like(rows))
            if not on_host(seen):
                return last_of_valid(self.cell, seen, valid)
            keep = valid.mT.to(weight.dtype, memory_format=torch.contiguous_format)
            last: Tensor = _Last.apply(seen.permute(1, 2, 0), keep, weight)  # type: ignore[no-untyped-call]
        return last.mT


def last_of_valid(
    cell: nn.LSTMCell, features: Float[Tensor, "R T f"], valid: Bool[Tensor, "R T"]
) -> Float[Tensor, "R h"]:
    """The state of `MaskedLSTM` by the LSTM of torch: a device takes it through all steps at once.

    Rows of time that are not valid change nothing, so those that are valid are moved to the front,
    and the state is taken after the last of them.
    """
    order = (~valid).long().argsort(dim=-1, stable=True).unsqueeze(-1)
    first = features.new_zeros(1, len(features), cell.hidden_size)
    weights = _beside_each_other(cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh)
    rows, learns = features.take_along_dim(order, 1), torch.is_grad_enabled()
    states = torch.lstm(rows, (first, first), weights, True, 1, 0.0, learns, False, True)[0]
    count = valid.sum(-1)[:, None, None]
    last = states.take_along_dim((count - 1).clamp_min(0), 1)
    return torch.where(count > 0, last, torch.zeros_like(last)).squeeze(1)


def _beside_each_other(*tensors: Tensor) -> list[Tensor]:
    """The same tensors in one block of memory, as the LSTM of a GPU wants its weights."""
    parts = torch.cat([each.flatten() for each in tensors]).split(
        [each.numel() for each in tensors]
    )
    return [part.view_as(each) for part, each in zip(parts, tensors, strict=True)]


class _Last(torch.autograd.Function):
    """Last state `h R` from features `T f R`, and its gradient.

    With the rows last, each gate is one block, and a step is one product with features, one and
    state below each other.
    """

    @staticmethod
    def forward(ctx: Any, features: Tensor, keep: Tensor, weight: Tensor) -> Tensor:
        size, (steps, inputs, rows) = len(weight) // 4, features.shape
        joined = features.new_ones(steps + 1, inputs + 1 + size, rows)
        joined[:steps, :inputs] = features
        memory = joined[0, inputs + 1 :].zero_()
        ctx.steps, needed = [], any(ctx.needs_input_grad)
        for time in range(steps):
            gates = weight @ joined[time]
            begin, forget, candidate, output = gates.split(size)
            gates[: 2 * size].sigmoid_()
            candidate.tanh_()
            output.sigmoid_()
            added = torch.addcmul(begin * candidate, forget, memory)
            squashed = added.tanh()
            if needed:
                ctx.steps.append(LSTMStep(memory, gates, squashed))
            before, after = joined[time : time + 2, inputs + 1 :]
            torch.lerp(before, output * squashed, keep[time], out=after)
            memory = torch.lerp(memory, added, keep[time])
        ctx.save_for_backward(joined[:-1], keep, weight)
        return joined[-1, inputs + 1 :].clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, None, Tensor]:
        joined, keep, weight = ctx.saved_tensors
        size = len(grad)
        by_hidden, by_memory = grad, torch.zeros_like(grad)
        by_weight, slopes = torch.zeros_like(weight), grad.new_empty(4 * size, grad.shape[-1])
        by_features = []
        for time in range(len(keep) - 1, -1, -1):
            by_state, by_next = keep[time] * by_hidden, keep[time] * by_memory
            by_memory = (
                by_memory - by_next + _into_gates(slopes, by_state, by_next, ctx.steps[time])
            )
            by_weight.addmm_(slopes, joined[time].mT)
            by_joined = weight.mT @ slopes
            by_hidden = by_hidden - by_state + by_joined[-size:]
            by_features.append(by_joined[: -size - 1])
        needed = ctx.needs_input_grad[0]
        return torch.stack(by_features[::-1]) if needed else None, None, by_weight


def _into_gates(slopes: Tensor, by_state: Tensor, by_memory: Tensor, step: LSTMStep) -> Tensor:
    """Fill the gradient in what enters the gates of a step; return the one in its memory."""
    size = len(by_state)
    begin, forget, candidate, output = step.gates.split(size)
    by_memory = by_memory + _tanh_slope(by_state * output, step.squashed)
    torch.mul(by_memory, candidate, out=slopes[:size])
    torch.mul(by_memory, step.memory, out=slopes[size : 2 * size])
    slopes[2 * size : 3 * size] = _tanh_slope(by_memory * begin, candidate)
    torch.mul(by_state, step.squashed, out=slopes[3 * size :])
    for rows in (slice(0, 2 * size), slice(3 * size, None)):
        slope = slopes[rows]
        torch.ops.aten.sigmoid_backward.grad_input(slope, step.gates[rows], grad_input=slope)
    return by_memory * forget


def _tanh_slope(slope: Tensor, value: Tensor) -> Tensor:
    """Gradient in the argument of a tanh from the one in its value."""
    result: Tensor = torch.ops.aten.tanh_backward(slope, value)
    return result
