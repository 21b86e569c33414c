"""C++ functions of scalar programs."""

import math
from collections.abc import Callable, Iterable, Sequence

from diffstack_mmv.control.native.scalar import CONSTANT, LEAF, Node, Program, needed

OPERATORS = {"add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "div": "{} / {}", "neg": "-{}"}
BINARY_FUNCTIONS = frozenset({"max", "min", "pow", "atan2", "fmod"})


def literal(value: float | bool) -> str:
    """A constant in C++, exact."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if math.isfinite(value):
        return f"Real({value!r})"
    limits = "std::numeric_limits<Real>"
    if math.isnan(value):
        return f"{limits}::quiet_NaN()"
    return f"{'-' if value < 0 else ''}{limits}::infinity()"


class Writer:
    """Writes the operations of one function.

    Args:
        program: The program.
        numbers: Names of the leaves that are plain numbers; all others are of type V.
    """

    def __init__(self, program: Program, numbers: str) -> None:
        self.program = program
        self.numbers = numbers
        self.plain: set[Node] = set()  # of the type Real (or bool) whatever V is

    def lines(self, wanted: Iterable[Node]) -> list[str]:
        """Definitions of all that some nodes need."""
        return [
            f"  const {self._type(node)} {self.name(node)} = {self._expression(node)};"
            for node in needed(self.program, wanted)
            if self.program.operations[node][0] != CONSTANT
        ]

    def name(self, node: Node) -> str:
        """A node in an expression."""
        operation = self.program.operations[node]
        return literal(operation[1]) if operation[0] == CONSTANT else f"v{node}"

    def lifted(self, node: Node) -> str:
        """The same with the type V."""
        is_plain = node in self.plain or self.program.operations[node][0] == CONSTANT
        return f"lift<V>({self.name(node)})" if is_plain else self.name(node)

    def _type(self, node: Node) -> str:
        operation = self.program.operations[node]
        truth = self.program.is_truth(node)
        if self._is_plain(operation):
            self.plain.add(node)
            return "bool" if truth else "Real"
        return "TruthOf<V>" if truth else "V"

    def _is_plain(self, operation: tuple) -> bool:
        if operation[0] == LEAF:
            return operation[1] in self.numbers
        return all(
            each in self.plain or self.program.operations[each][0] == CONSTANT
            for each in operation[1:]
        )

    def _expression(self, node: Node) -> str:
        name, *arguments = self.program.operations[node]
        if name == LEAF:
            return f"{arguments[0]}[{arguments[1]}]"
        if name in OPERATORS:
            return OPERATORS[name].format(*map(self.name, arguments))
        if name == "where":
            return self._choice(node, *arguments)
        written = self._of_one_type(node) if name in BINARY_FUNCTIONS else self.name
        return f"op_{name}({', '.join(map(written, arguments))})"

    def _choice(self, node: Node, condition: Node, a: Node, b: Node) -> str:
        if self.program.is_truth(node):
            c, first, second = map(self.name, (condition, a, b))
            return f"op_or(op_and({c}, {first}), op_and(op_not({c}), {second}))"
        written = self._of_one_type(node)
        return f"choose({self.name(condition)}, {written(a)}, {written(b)})"

    def _of_one_type(self, node: Node) -> Callable[[Node], str]:
        """How arguments are written that have to be of the type of their result."""
        return self.name if node in self.plain else self.lifted


def function(
    signature: str, program: Program, numbers: str, outputs: Sequence[tuple[str, Node]]
) -> str:
    """A function that computes outputs (where to, what) of a type V."""
    writer = Writer(program, numbers)
    lines = writer.lines([node for _, node in outputs])
    ends = [f"  {place} = {writer.lifted(node)};" for place, node in outputs]
    return "\n".join([f"{signature} {{", *lines, *ends, "}"])


def into(array: str, nodes: Iterable[Node]) -> list[tuple[str, Node]]:
    """Nodes and the entries of an array that they go to."""
    return [(f"{array}[{index}]", node) for index, node in enumerate(nodes)]


def table(kind: str, name: str, values: Sequence[float]) -> str:
    """An array of constants."""
    entries = ", ".join(str(v) if kind == "int" else literal(v) for v in values) or "0"
    return f"static constexpr {kind} {name}[] = {{{entries}}};"


def rows_of(name: str, rows: Sequence[Sequence[int]], width: int) -> str:
    """A table of constants, its rows filled up with zeros."""
    padded = ([*row, *[0] * (width - len(row))] or [0] for row in rows)
    body = ", ".join("{" + ", ".join(map(str, row)) + "}" for row in padded)
    return f"static constexpr int {name}[{len(rows)}][{max(width, 1)}] = {{{body}}};"
