"""Products of small matrices with the batch in the last dimension, and the walk over time.

Inside of the solver the batch N is the contiguous dimension: (time, rows, N) and (rows, columns,
N). A matrix of a handful of rows is then a sum of a few long vectors, which a compiler turns into
vector instructions over the batch and an eager CPU runs as a few large operations, where batched
matrix products would call one tiny product per problem.
"""

import math
from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch._higher_order_ops.scan import scan


def product(P: Float[Tensor, "a b N"], Q: Float[Tensor, "b c N"]) -> Tensor:
    """P Q."""
    return (P.unsqueeze(2) * Q.unsqueeze(0)).sum(1)


def transposed_product(P: Float[Tensor, "b a N"], Q: Float[Tensor, "b c N"]) -> Tensor:
    """P' Q."""
    return (P.unsqueeze(2) * Q.unsqueeze(1)).sum(0)


def apply(P: Float[Tensor, "a b ..."], v: Float[Tensor, "b ..."]) -> Float[Tensor, "a ..."]:
    """P v."""
    return (P * v.unsqueeze(0)).sum(1)


def transposed_apply(P: Float[Tensor, "b a N"], v: Float[Tensor, "b N"]) -> Float[Tensor, "a N"]:
    """P' v."""
    return (P * v.unsqueeze(1)).sum(0)


def symmetric(P: Float[Tensor, "a a N"]) -> Tensor:
    """Symmetric part of P."""
    return 0.5 * (P + P.transpose(0, 1))


def unpack(packed: Float[Tensor, "*t R N"], *shapes: tuple[int, ...]) -> tuple[Tensor, ...]:
    """Cut rows into matrices and vectors of these shapes, views all of them."""
    parts = packed.split([math.prod(shape) for shape in shapes], -2)
    pairs = zip(parts, shapes, strict=True)
    # not the method: a mode as `ShapePolymorphic` makes it one that the compiler refuses
    return tuple(torch.unflatten(part, -2, shape) for part, shape in pairs)


def pack(*parts: Float[Tensor, "... N"]) -> Float[Tensor, "R N"]:
    """Inverse of `unpack`: one column of rows from matrices and vectors with the batch last."""
    return torch.concatenate([part.flatten(0, -2) for part in parts])


def walk(
    step: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]],
    carry: Tensor,
    inputs: Float[Tensor, "T R N"],
    reverse: bool = False,
) -> tuple[Tensor, Tensor]:
    """Carry a value through time, forward or backward, and stack the outputs, oldest time first.

    One tensor each is carried, read and written, so that a compiled step costs one slice. Compiled,
    the step becomes one loop body (a graph as long as one step); eagerly it is a Python loop.
    """
    if torch.compiler.is_compiling():
        return _compiled_walk(step, carry, inputs, reverse)
    outputs: list[Tensor] = []
    for row in inputs.flip(0) if reverse else inputs:
        carry, output = step(carry, row)
        outputs.append(output)
    return carry, torch.stack(outputs[::-1] if reverse else outputs)


def _compiled_walk(
    step: Callable[..., Any], carry: Tensor, inputs: Tensor, reverse: bool
) -> tuple[Tensor, Tensor]:
    """The same as one loop in the graph, whose carry and output must not share memory.

    A single step is none: what the compiler writes for a loop of one does not compile.
    """
    if len(inputs) == 1:
        following, output = step(carry, inputs[0])
        return following, output.unsqueeze(0)

    def separate(carry: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        following, output = step(carry, row)
        return _fresh(following), _fresh(output)

    return scan(separate, _fresh(carry), inputs.contiguous(), reverse=reverse)


def _fresh(tensor: Tensor) -> Tensor:
    return tensor.clone(memory_format=torch.contiguous_format)


def to_batch_last(tensor: Tensor, like: Float[Tensor, "*b"]) -> Tensor:
    """(*b, rows...) to (rows..., N), N the product of *b, the shape of `like`."""
    return tensor.reshape((like.numel(), *tensor.shape[like.dim() :])).movedim(0, -1)


def from_batch_last(tensor: Tensor, like: Float[Tensor, "*b"]) -> Tensor:
    """(rows..., N) back to (*b, rows...)."""
    rows = tensor.movedim(-1, 0)
    return rows.reshape((*like.shape, *rows.shape[1:]))
