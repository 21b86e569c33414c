"""From a graph of tensor operations to a scalar program, entry by entry."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.fx import GraphModule
from torch.fx.node import map_arg

from diffstack_mmv.control.native.scalar import Node, Program

Entries = np.ndarray
"""Nodes of the entries of a tensor, in its shape."""

Handler = Callable[..., Any]


class CannotLowerError(Exception):
    """A graph has an operation that has no scalar form here."""


class Lowering:
    """Interprets a graph of core operations on arrays of nodes.

    Args:
        program: Where the operations go.
        handlers: What each operation does, by its name.
    """

    def __init__(self, program: Program, handlers: Mapping[str, Handler]) -> None:
        self.program = program
        self.handlers = handlers

    def __call__(self, graph: GraphModule, inputs: Sequence[Entries]) -> list[Entries]:
        """Entries of the outputs of a graph for those of its inputs.

        Raises:
            CannotLowerError: An operation is not known, or indexes by what is not constant.
        """
        known: dict[Any, Any] = {}
        given = iter(inputs)
        for node in graph.graph.nodes:
            match node.op:
                case "placeholder":
                    known[node] = next(given)
                case "get_attr":
                    known[node] = self.constants(getattr(graph, str(node.target)))
                case "output":
                    return [known[each] for each in node.args[0]]
                case _:
                    known[node] = self._called(node, known)
        raise CannotLowerError("a graph without output")

    def constants(self, value: Tensor | float | bool | list[Any]) -> Entries:
        """Constant nodes of numbers."""
        flat = value.detach().tolist() if isinstance(value, Tensor) else value
        array = np.array(flat, dtype=object)
        return _each(self.program.constant, array)

    def entries(self, value: Any) -> Entries:
        """An argument as nodes, whether it is a tensor or a number."""
        return value if isinstance(value, np.ndarray) else self.constants(value)

    def map(self, name: str, *arguments: Any) -> Entries:
        """An operation on every entry, with broadcasting."""
        arrays = np.broadcast_arrays(*(self.entries(argument) for argument in arguments))
        return _each(lambda *nodes: self.program.apply(name, *nodes), *arrays)

    def numbers(self, value: Any) -> Entries:
        """Truths as numbers."""
        return _each(self.program.number, self.entries(value))

    def truths(self, value: Any) -> Entries:
        """Numbers as truths."""
        return _each(self.program.truth, self.entries(value))

    def values(self, entries: Entries) -> list[Any]:
        """Values of entries that have to be constant.

        Raises:
            CannotLowerError: One is not.
        """
        values = [self.program.value(node) for node in entries.flat]
        if None in values:
            raise CannotLowerError("an index that is not constant")
        return values

    def _called(self, node: torch.fx.Node, known: dict[Any, Any]) -> Any:
        name = str(node.target).removeprefix("aten.").split(".", maxsplit=1)[0]
        handler = self.handlers.get(name)
        if handler is None:
            raise CannotLowerError(str(node.target))
        arguments = map_arg(node.args, lambda each: known[each])
        options = map_arg(node.kwargs, lambda each: known[each])
        return handler(self, *arguments, **options)


def _each(function: Callable[..., Node], *arrays: Entries) -> Entries:
    """The function at every entry of arrays of one shape."""
    shape = arrays[0].shape
    result = np.empty(shape, dtype=object)
    columns = [list(array.flat) for array in arrays]
    for position, nodes in zip(itertools.count(), zip(*columns, strict=True)):
        result.flat[position] = function(*nodes)
    return result
