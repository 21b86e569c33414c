"""C++ loops over the like terms of a cost."""

from collections.abc import Sequence

from diffstack_mmv.control.native.code import Writer
from diffstack_mmv.control.native.scalar import CONSTANT, LEAF, Node, Program, needed
from diffstack_mmv.control.native.stages import Repeated, Stage

OF_A_TERM = "r"


def with_sums(text: str, stage: Stage, nodes: Sequence[Node]) -> str:
    """A function that writes y[0], y[1], ..., with sums of nodes of the like terms added.

    Args:
        text: The function without.
        stage: The cost.
        nodes: What each term adds to each entry.
    """
    if stage.repeated is None:
        return text
    program = stage.repeated.term.program
    entries = [(k, node) for k, node in enumerate(nodes) if program.value(node) != 0]
    before = [f"  V s{k} = lift<V>(Real(0));" for k, _ in entries]
    after = [f"  y[{k}] = y[{k}] + s{k};" for k, _ in entries]
    named = [(f"s{k} = s{k} + ", node) for k, node in entries]
    return _closed(text, [*before, *_loop(stage, stage.repeated, named), *after])


def with_entries(text: str, stage: Stage, nodes: Sequence[Node]) -> str:
    """A function that writes one entry per number, with those of the like terms behind.

    Args:
        text: The function without.
        stage: The cost.
        nodes: What each term writes for each of its numbers.
    """
    if stage.repeated is None:
        return text
    each = stage.repeated.term.numbers
    named = [
        (f"y[{stage.own_numbers} + j * {each} + {k}] = ", node) for k, node in enumerate(nodes)
    ]
    return _closed(text, _loop(stage, stage.repeated, named))


def _loop(stage: Stage, repeated: Repeated, named: Sequence[tuple[str, Node]]) -> list[str]:
    """The loop; what is the same for all terms stands before it."""
    program = repeated.term.program
    writer = Writer(program, "q" + OF_A_TERM)
    order = [
        node
        for node in needed(program, [node for _, node in named])
        if program.operations[node][0] != CONSTANT
    ]
    lines = dict(zip(order, writer.lines(order), strict=True))
    varying = _varying(program, order)
    return [
        *(line for node, line in lines.items() if node not in varying),
        f"  for (int j = 0; j < {repeated.count}; ++j) {{",
        f"  const Real* {OF_A_TERM} = q + {stage.own_numbers} + j * {repeated.term.numbers};",
        *(line for node, line in lines.items() if node in varying),
        *(f"  {start}{writer.lifted(node)};" for start, node in named),
        "  }",
    ]


def _varying(program: Program, order: Sequence[Node]) -> set[Node]:
    """Nodes that differ from term to term."""
    varying: set[Node] = set()
    for node in order:
        name, *arguments = program.operations[node]
        own = name == LEAF and arguments[0] == OF_A_TERM
        if own or (name != LEAF and not varying.isdisjoint(arguments)):
            varying.add(node)
    return varying


def _closed(text: str, lines: Sequence[str]) -> str:
    """A function with a block at its end."""
    return "\n".join([text.removesuffix("}"), "  {", *lines, "  }", "}"])
