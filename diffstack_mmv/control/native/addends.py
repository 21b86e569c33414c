"""Sums of many like terms, as over agents: one of them is written, in a loop over their numbers."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from diffstack_mmv.control.native.scalar import Node, Program

FEWEST = 8
"""Like terms from which on a loop is written."""


class Addend(NamedTuple):
    """A node under operations that commute with a sum, the outermost first."""

    node: Node
    wrapped: tuple[Callable[[Node], Node], ...] = ()

    def under(self, node: Node, wrap: Callable[[Node], Node]) -> "Addend":
        """The same wrapping and one more, of an argument of this node."""
        return Addend(node, (*self.wrapped, wrap))

    def built(self) -> Node:
        """The whole as a node."""
        node = self.node
        for wrap in reversed(self.wrapped):
            node = wrap(node)
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
            found.append(each.built())
        else:
            stack.extend(reversed(inner))
    return found


def _inner(program: Program, each: Addend, own: np.ndarray) -> Sequence[Addend] | None:
    """Addends of an addend, None where it is no sum."""
    name, *arguments = program.operations[each.node]
    rule = None if own[each.node] else _RULES.get(name)
    return None if rule is None else rule(program, each, own, *arguments)


def _add(program: Program, each: Addend, own: np.ndarray, a: Node, b: Node) -> Sequence[Addend]:
    return [Addend(a, each.wrapped), Addend(b, each.wrapped)]


def _sub(program: Program, each: Addend, own: np.ndarray, a: Node, b: Node) -> Sequence[Addend]:
    return [Addend(a, each.wrapped), each.under(b, partial(program.apply, "neg"))]


def _neg(program: Program, each: Addend, own: np.ndarray, a: Node) -> Sequence[Addend]:
    return [each.under(a, partial(program.apply, "neg"))]


def _mul(
    program: Program, each: Addend, own: np.ndarray, a: Node, b: Node
) -> Sequence[Addend] | None:
    if not (own[a] or own[b]):
        return None
    factor, rest = (a, b) if own[a] else (b, a)
    return [each.under(rest, lambda node: program.apply("mul", node, factor))]


def _div(
    program: Program, each: Addend, own: np.ndarray, a: Node, b: Node
) -> Sequence[Addend] | None:
    return [each.under(a, lambda node: program.apply("div", node, b))] if own[b] else None


def _where(
    program: Program, each: Addend, own: np.ndarray, condition: Node, a: Node, b: Node
) -> Sequence[Addend] | None:
    if not own[condition] or program.value(b) != 0:
        return None
    zero = program.constant(0.0)
    return [each.under(a, lambda node: program.apply("where", condition, node, zero))]


_RULES: dict[str, Callable[..., Sequence[Addend] | None]] = {
    "add": _add,
    "sub": _sub,
    "neg": _neg,
    "mul": _mul,
    "div": _div,
    "where": _where,
}
"""How each operation that is a sum, or commutes with one, comes apart."""
