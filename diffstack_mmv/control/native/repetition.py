"""C++ loops over the like terms of a cost."""

from collections.abc import Sequence
from typing import NamedTuple

from diffstack_mmv.control.native.code import Writer
from diffstack_mmv.control.native.scalar import CONSTANT, LEAF, Node, Program, needed
from diffstack_mmv.control.native.stages import Repeated, Stage

OF_A_TERM = "r"


class Summand(NamedTuple):
    """A node that is added to some entries of an array."""

    places: tuple[int, ...]
    node: Node


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


def added_terms(kind: int, stage: Stage, entries: Sequence[Summand]) -> str:
    """The function `add_terms_...`: adds nodes of the like terms to y, eight terms at a time.

    Args:
        kind: Of the cost.
        stage: The cost.
        entries: What each term adds, and where to.
    """
    point = "const Real* x, const Real* u, const Real* q, Real* y"
    head, repeated = f"static void add_terms_{kind}({point}) {{", stage.repeated
    entries = [each for each in entries if repeated and repeated.term.program.value(each.node) != 0]
    if repeated is None or not entries:
        return head + "}"
    writer = Writer(repeated.term.program, "xuq")
    before, within = _written(writer, [each.node for each in entries])
    each, count = repeated.term.numbers, repeated.count
    sums = [f"  s{i} = s{i} + counted({writer.lifted(e.node)});" for i, e in enumerate(entries)]
    totals = [f"    y[{place}] += s{i}[lane];" for i, e in enumerate(entries) for place in e.places]
    return "\n".join(
        [
            head,
            "  using V = Pack;",
            *before,
            *(f"  V s{i} = {{}};" for i, _ in enumerate(entries)),
            f"  for (int j = 0; j < {count}; j += LANES) {{",
            f"  const int lanes = {count} - j < LANES ? {count} - j : LANES;",
            f"  V {OF_A_TERM}[{max(each, 1)}];",
            "  Mask is_term = {};",
            "  for (int lane = 0; lane < LANES; ++lane) {",
            "    const int term = j + (lane < lanes ? lane : 0);",
            f"    const Real* one = q + {stage.own_numbers} + term * {each};",
            f"    for (int k = 0; k < {each}; ++k) {OF_A_TERM}[k][lane] = one[k];",
            "    is_term[lane] = lane < lanes ? -1 : 0;",
            "  }",
            "  const auto counted = [&](const V& a) {",
            "    return lanes == LANES ? a : choose(is_term, a, V{});",
            "  };",
            *within,
            *sums,
            "  }",
            "  for (int lane = 0; lane < LANES; ++lane) {",
            *totals,
            "  }",
            "}",
        ]
    )


def _loop(stage: Stage, repeated: Repeated, named: Sequence[tuple[str, Node]]) -> list[str]:
    """The loop; what is the same for all terms stands before it."""
    writer = Writer(repeated.term.program, "q" + OF_A_TERM)
    before, within = _written(writer, [node for _, node in named])
    return [
        *before,
        f"  for (int j = 0; j < {repeated.count}; ++j) {{",
        f"  const Real* {OF_A_TERM} = q + {stage.own_numbers} + j * {repeated.term.numbers};",
        *within,
        *(f"  {start}{writer.lifted(node)};" for start, node in named),
        "  }",
    ]


def _written(writer: Writer, nodes: Sequence[Node]) -> tuple[list[str], list[str]]:
    """Lines of what is the same for all terms, and of what is not."""
    program = writer.program
    order = [node for node in needed(program, nodes) if program.operations[node][0] != CONSTANT]
    varying = _varying(program, order)
    lines = list(zip(order, writer.lines(order), strict=True))
    before = [line for node, line in lines if node not in varying]
    return before, [line for node, line in lines if node in varying]


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
