"""Sums of many like terms, as over agents: one of them is written, in a loop over their numbers."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diffstack_mmv.control.native.scalar import Node, Program

FEWEST = 8
"""Like terms from which on a loop is written."""


class Addend(NamedTuple):
    """A node under operations that commute with a sum, the outermost first."""

    node: Node
    wrapped: tuple[tuple[str, tuple[Node, ...]], ...] = ()  # operation, its other arguments

    def under(self, node: Node, name: str, *others: Node) -> "Addend":
        """The same wrapping and one more, of an argument of this node."""
        return Addend(node, (*self.wrapped, (name, others)))

    def built(self, program: Program) -> Node:
        """The whole as a node."""
        node, zero = self.node, program.constant(0.0)
        for name, others in reversed(self.wrapped):
            if name == "neg":
                node = program.apply("neg", node)
            elif name == "where":
                node = program.apply("where", *others, node, zero)
            else:
                node = program.apply(name, node, *others)
        return node


def addends(program: Program, root: Node, own: np.ndarray) -> list[Node]:
    """Nodes whose sum is a node, in their order.

    Args:
        program: Where they are written to.
        root: The sum.
        own: Which nodes depend on parameters and constants alone: factors and conditions.
    """
    stack, found = [Addend(root)], []
    while stack:
        each = stack.pop()
        inner = _inner(program, each, own)
        if inner is None:
            found.append(each.built(program))
        else:
            stack.extend(reversed(inner))
    return found


def _inner(program: Program, each: Addend, own: np.ndarray) -> Sequence[Addend] | None:
    """Addends of an addend, None where it is no sum."""
    name, *arguments = program.operations[each.node]
    if own[each.node]:
        return None
    if name in ("add", "sub"):
        first, second = (Addend(argument, each.wrapped) for argument in arguments)
        return [first, second if name == "add" else each.under(arguments[1], "neg")]
    if name == "neg":
        return [each.under(arguments[0], "neg")]
    if name == "mul" and (own[arguments[0]] or own[arguments[1]]):
        factor, rest = arguments if own[arguments[0]] else reversed(arguments)
        return [each.under(rest, "mul", factor)]
    if name == "div" and own[arguments[1]]:
        return [each.under(arguments[0], "div", arguments[1])]
    if name == "where" and own[arguments[0]] and program.value(arguments[2]) == 0:
        return [each.under(arguments[1], "where", arguments[0])]
    return None
