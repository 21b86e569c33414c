"""Scalar programs: straight lines of operations on single numbers, each computed once.

Tensors of a handful of entries are a poor fit for tensor programs: an operation costs microseconds
and does nanoseconds of work. Here every entry is a node of its own. Equal nodes are one node,
constants are folded, and products with a constant zero are gone, so that the zeros of a Jacobian
cost nothing.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

Node = int
"""Index of an operation in its `Program`; the arguments of an operation come before it."""

LEAF, CONSTANT = "leaf", "constant"
TRUTHS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"})
"""Operations whose value is true or false."""


def _divided(a: float, b: float) -> float:
    if b == 0:
        sign = math.copysign(1.0, a) * math.copysign(1.0, b)
        return math.nan if a == 0 or math.isnan(a) else sign * math.inf
    return a / b


FOLDS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": _divided,
    "pow": math.pow,  # a ** b would be complex for a fraction of a negative number
    "fmod": math.fmod,
    "atan2": math.atan2,
    "max": max,
    "min": min,
    "neg": lambda a: -a,
    "abs": abs,
    "sign": lambda a: math.copysign(1.0, a) if a else 0.0,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "log": math.log,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "atan": math.atan,
    "asin": math.asin,
    "acos": math.acos,
    "sinh": math.sinh,
    "cosh": math.cosh,
    "tanh": math.tanh,
    "log1p": math.log1p,
    "expm1": math.expm1,
    "erf": math.erf,
    "floor": lambda a: float(math.floor(a)),
    "ceil": lambda a: float(math.ceil(a)),
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "and": lambda a, b: bool(a) and bool(b),
    "or": lambda a, b: bool(a) or bool(b),
    "not": lambda a: not a,
    "where": lambda condition, a, b: a if condition else b,
}
"""Every operation, by its value on constants."""


class Program:
    """Operations in the order in which they are computed."""

    def __init__(self) -> None:
        self.operations: list[tuple[Any, ...]] = []
        self._known: dict[tuple[Any, ...], Node] = {}

    def __len__(self) -> int:
        return len(self.operations)

    def leaf(self, *name: Any) -> Node:
        """A number that is given from outside."""
        return self._node((LEAF, *name))

    def constant(self, value: float | bool) -> Node:
        """A number that is known."""
        number = value if isinstance(value, bool) else float(value)
        # 0.0 and -0.0 are equal, and so are True and 1.0, but they are not the same
        return self._node((CONSTANT, number, type(number), math.copysign(1.0, number)))

    def value(self, node: Node) -> Any:
        """The value of a constant, None for everything else."""
        operation = self.operations[node]
        return operation[1] if operation[0] == CONSTANT else None

    def is_truth(self, node: Node) -> bool:
        """Whether a node is true or false."""
        operation = self.operations[node]
        if operation[0] == CONSTANT:
            return isinstance(operation[1], bool)
        if operation[0] == "where":
            return self.is_truth(operation[2])
        return operation[0] in TRUTHS

    def opposite(self, node: Node) -> Node | None:
        """The node whose sign this one turns, None if it turns none."""
        operation = self.operations[node]
        return operation[1] if operation[0] == "neg" else None

    def number(self, node: Node) -> Node:
        """A truth as 1 or 0; a number as it is."""
        if not self.is_truth(node):
            return node
        return self.apply("where", node, self.constant(1.0), self.constant(0.0))

    def truth(self, node: Node) -> Node:
        """Whether a number differs from zero; a truth as it is."""
        return node if self.is_truth(node) else self.apply("ne", node, self.constant(0.0))

    def apply(self, name: str, *arguments: Node) -> Node:
        """The node of an operation on nodes, as simple as it gets."""
        values = [self.value(argument) for argument in arguments]
        if None not in values:
            try:
                return self.constant(FOLDS[name](*values))
            except (ValueError, OverflowError, ZeroDivisionError):
                return self._node((name, *arguments))
        simpler = self._simplified(name, arguments, values)
        return self._node((name, *arguments)) if simpler is None else simpler

    def total(self, nodes: Iterable[Node]) -> Node:
        """Sum of nodes, from the first to the last."""
        result = self.constant(0.0)
        for node in nodes:
            result = self.apply("add", result, node)
        return result

    def _node(self, operation: tuple[Any, ...]) -> Node:
        node = self._known.get(operation)
        if node is None:
            node = self._known[operation] = len(self.operations)
            self.operations.append(operation)
        return node

    def _simplified(self, name: str, arguments: Sequence[Node], values: list[Any]) -> Node | None:
        rule = _SIMPLER.get(name)
        return None if rule is None else rule(self, arguments, values)


def _add(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    a, b = arguments
    if values[0] == 0:
        return b
    if values[1] == 0:
        return a
    opposite = program.opposite(b)
    return None if opposite is None else program.apply("sub", a, opposite)


def _sub(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    a, b = arguments
    if values[1] == 0:
        return a
    if values[0] == 0:
        return program.apply("neg", b)
    opposite = program.opposite(b)
    return None if opposite is None else program.apply("add", a, opposite)


def _mul(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    for node, value in zip(arguments, reversed(values), strict=True):
        if value == 0:
            return program.constant(0.0)
        if value == 1:
            return node
        if value == -1:
            return program.apply("neg", node)
    for node, other in zip(arguments, reversed(arguments), strict=True):
        chosen = program.operations[other]
        if chosen[0] == "where" and None not in map(program.value, chosen[2:]):
            # the branch not taken may be infinite, and infinity times zero is no number
            either = (program.apply("mul", node, branch) for branch in chosen[2:])
            return program.apply("where", chosen[1], *either)
    a, b = sorted(arguments)  # one node for both orders
    return program._node(("mul", a, b))


def _div(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    if values[1] == 1:
        return arguments[0]
    return program.constant(0.0) if values[0] == 0 else None


def _neg(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    opposite = program.opposite(arguments[0])
    if opposite is not None:
        return opposite
    inner = program.operations[arguments[0]]
    return program.apply("sub", inner[2], inner[1]) if inner[0] == "sub" else None


def _where(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    condition, a, b = arguments
    if values[0] is not None:
        return a if values[0] else b
    return a if a == b else None


def _and(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    for node, value in zip(arguments, reversed(values), strict=True):
        if value is not None:
            return node if value else program.constant(False)
    return None


def _or(program: Program, arguments: Sequence[Node], values: list[Any]) -> Node | None:
    for node, value in zip(arguments, reversed(values), strict=True):
        if value is not None:
            return program.constant(True) if value else node
    return None


_SIMPLER: dict[str, Callable[[Program, Sequence[Node], list[Any]], Node | None]] = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "neg": _neg,
    "where": _where,
    "and": _and,
    "or": _or,
}


def arguments_of(program: Program, node: Node) -> tuple[Node, ...]:
    """Nodes that an operation reads."""
    operation = program.operations[node]
    return () if operation[0] in (LEAF, CONSTANT) else operation[1:]


def needed(program: Program, wanted: Iterable[Node], known: Iterable[Node] = ()) -> list[Node]:
    """All nodes that have to be computed for some, in order, without those already known."""
    have, stack, found = set(known), list(wanted), set()
    while stack:
        node = stack.pop()
        if node in found or node in have:
            continue
        found.add(node)
        stack.extend(arguments_of(program, node))
    return sorted(found)
