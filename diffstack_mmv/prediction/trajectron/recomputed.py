"""Functions of rows whose backward pass runs only over the rows that a loss looks at."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.prediction.trajectron.rows import chosen

RowFunction = Callable[..., tuple[Tensor, ...]]


def recomputed(
    function: RowFunction, rows: tuple[Tensor, ...], parameters: Iterable[Tensor]
) -> tuple[Tensor, ...]:
    """Evaluate a function of rows without a graph; rows that matter are evaluated again backward.

    A loss of a mixture hardly depends on most of its components. Whichever row of the results has
    a gradient of zero is left out of the backward pass where rows are gathered, see `chosen`, and
    nothing is kept for any. Can be differentiated once; a second derivative is refused.

    Args:
        function: Takes tensors that all begin with the dimension of the rows, and returns such
            tensors; each row of the results depends on the same row of the arguments alone. It is
            called again in the backward pass, and has to give the same.
        rows: Its arguments.
        parameters: All other tensors that it depends on. Autocast does not act on the function.
    """
    learning = [parameter for parameter in parameters if parameter.requires_grad]
    tensors = (*rows, *learning)
    # the second evaluation has to be as precise as the first, and comes when autocast is over
    with torch.autocast(rows[0].device.type, enabled=False):
        if not (torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)):
            return function(*rows)
        results: tuple[Tensor, ...] = _Recomputed.apply(function, len(rows), *tensors)  # type: ignore[no-untyped-call]
        return results


class _Recomputed(torch.autograd.Function):
    """`recomputed` where something has a gradient."""

    @staticmethod
    def forward(
        ctx: Any, function: RowFunction, count: int, *tensors: Tensor
    ) -> tuple[Tensor, ...]:
        ctx.function, ctx.count = function, count
        ctx.save_for_backward(*tensors)
        return function(*tensors[:count])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        rows, parameters = ctx.saved_tensors[: ctx.count], ctx.saved_tensors[ctx.count :]
        index = chosen(_any_gradient(grads)).index
        part = [
            row[index].requires_grad_(needed)
            for row, needed in zip(rows, ctx.needs_input_grad[2:], strict=False)
        ]
        with torch.enable_grad():
            results = ctx.function(*part)
        sources = [tensor for tensor in (*part, *parameters) if tensor.requires_grad]
        slopes = iter(
            torch.autograd.grad(
                results, sources, [grad[index] for grad in grads], allow_unused=True
            )
        )
        return (
            None,
            None,
            *(
                _spread(next(slopes), index, row) if piece.requires_grad else None
                for piece, row in zip(part, rows, strict=True)
            ),
            *slopes,
        )


def _any_gradient(grads: tuple[Tensor, ...]) -> Bool[Tensor, " N"]:
    """Rows in which any of the gradients is not zero; NaN is not."""
    flags = [(grad != 0).flatten(1).any(-1) for grad in grads]
    return torch.stack(flags).any(0)


def _spread(slope: Tensor | None, index: Tensor, row: Tensor) -> Tensor | None:
    """Gradient in all rows from the one in some."""
    return None if slope is None else torch.zeros_like(row).index_copy(0, index, slope)
