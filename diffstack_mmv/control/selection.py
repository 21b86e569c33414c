"""Leaves finished problems behind, so that the last hard ones cost less than the batch."""

import functools
import types
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from diffstack_mmv.control.iteration import OPEN, Iterate
from diffstack_mmv.types import on_host

SMALLEST = 8  # problems; below, there is nothing to win
NOTHING = torch.zeros(0, dtype=torch.long)


@runtime_checkable
class Selectable(Protocol):
    """A callable that can be narrowed to some of its problems; closures cannot, see `Batched`."""

    def select(self, index: Int[Tensor, " k"]) -> Self:
        """The same callable for the problems `index` of a batch with one leading dimension.

        One that returns itself is shared by all problems.
        """
        ...


class Batched:
    """A dynamics or cost function with its tensors named, which makes it selectable.

    Args:
        function: Called with the usual arguments and then the tensors: a function, a bound method
            or a module. Whatever all problems share, such as its learnable parameters, stays in
            it, and must not be an attribute with one entry per problem.
        tensors: Tensors of any type with one entry per problem, shape (B, ...).
    """

    def __init__(self, function: Callable[..., Tensor], *tensors: Shaped[Tensor, "B ..."]) -> None:
        self.function = function
        self.tensors = tensors

    def __call__(self, *arguments: Any) -> Tensor:
        """Call the function with its tensors."""
        return self.function(*arguments, *self.tensors)

    def select(self, index: Int[Tensor, " k"]) -> "Batched":
        """The same function with the entries `index` of its tensors; itself if it has none."""
        if not self.tensors:
            return self
        return Batched(self.function, *(tensor[index] for tensor in self.tensors))


class Joined(Batched):
    """A batched function of others, by which the compiler tells it from others of the same code.

    Args:
        function: Called as that of `Batched`.
        parts: What it calls.
        tensors: As those of `Batched`.
    """

    def __init__(
        self,
        function: Callable[..., Tensor],
        parts: Sequence[Callable[..., Tensor]],
        *tensors: Shaped[Tensor, "B ..."],
    ) -> None:
        super().__init__(function, *tensors)
        self.parts = parts

    def select(self, index: Int[Tensor, " k"]) -> "Joined":
        """The same function with the entries `index` of its tensors."""
        return Joined(self.function, self.parts, *(tensor[index] for tensor in self.tensors))


def is_shared(function: Any) -> bool:
    """Whether a callable is the same for all problems: it says so by selecting itself."""
    return isinstance(function, Selectable) and function.select(NOTHING) is function


def kind(function: Any) -> Hashable:
    """What callables that share a kernel have in common: their code, not what they close over."""
    if isinstance(function, functools.partial):
        return kind(function.func)
    if isinstance(function, Joined):
        return kind(function.function), *map(kind, function.parts), len(function.tensors)
    if isinstance(function, Batched):
        return kind(function.function), len(function.tensors)
    if isinstance(function, types.MethodType):
        return kind(function.__func__), type(function.__self__)
    return getattr(function, "__code__", type(function))


def constant(function: Any) -> Any:
    """The same callable with plain tensors: one kernel serves training and evaluation.

    They have no graph, and are laid out as `select` will lay out theirs.
    """
    if not isinstance(function, Batched):
        return function
    return Batched(function.function, *(each.detach().contiguous() for each in function.tensors))


def lenders(valid: Bool[Tensor, "*b"]) -> Int[Tensor, " b"] | None:
    """Which problem each is differentiated as: itself, or the first valid one in place of it.

    The tensors of a failed problem may be NaN, and zero times a derivative that is NaN would reach
    what it shares with others, such as the weights of a cost.

    Returns:
        Indices into a batch of one leading dimension; None if there is nobody to stand in, or no
        need to.
    """
    if valid.dim() != 1 or not len(valid) or (on_host(valid) and bool(valid.all())):
        return None
    own = torch.arange(len(valid), device=valid.device)
    return torch.where(valid, own, valid.long().argmax())


def lent(function: Any, index: Int[Tensor, " b"]) -> Any:
    """A callable for the problems `index`; one that cannot be narrowed as it is."""
    return function.select(index) if isinstance(function, Selectable) else function


class Workload(NamedTuple):
    """The problems that are iterated, and where the finished ones wait."""

    dynamics: Any
    cost: Any
    like: Float[Tensor, "*b"]
    iterate: Iterate
    index: Int[Tensor, " k"] | None  # positions of the iterated problems among all; None: all
    whole: Iterate  # all problems as of the last narrowing

    def merged(self) -> Iterate:
        """All problems, the iterated ones as they stand now."""
        index = self.index
        if index is None:
            return self.iterate
        pairs = zip(self.whole, self.iterate, strict=True)
        return Iterate(*(old.index_copy(-1, index, new) for old, new in pairs))

    def narrowed(self) -> "Workload":
        """Only the problems that are still open, if the callables can follow and it is worth it."""
        able = isinstance(self.dynamics, Selectable) and isinstance(self.cost, Selectable)
        if not able or self.like.dim() != 1 or len(self.like) <= SMALLEST or not on_host(self.like):
            return self
        keep = (self.iterate.status == OPEN).nonzero().squeeze(-1)
        size = len(self.like)
        while size >= 2 * max(len(keep), SMALLEST // 2):
            size = (size + 1) // 2
        if size == len(self.like):
            return self
        # halves only, filled up with copies: few sizes, each of which may have to be compiled
        keep = torch.cat([keep, keep[:1].expand(size - len(keep))])
        index = keep if self.index is None else self.index[keep]
        part = Iterate(*(field.index_select(-1, keep) for field in self.iterate))
        narrow = self.dynamics.select(keep), self.cost.select(keep)
        return Workload(*narrow, self.like[keep], part, index, self.merged())
