"""What every generated library is written with."""

from collections.abc import Sequence

from diffstack_mmv.control.native.code import function, into, literal
from diffstack_mmv.control.native.scalar import Node, Program
from dmmv_conventions.libraries import header as header_of

TEMPLATE, POINT = "template <class V> static", "const V* x, const V* u"


def opening(real: str, *headers: str) -> list[str]:
    """What every library begins with, in one precision."""
    return [
        "#include <cmath>",
        "#include <type_traits>",
        "#include <utility>",
        f"typedef {real} Real;",
        header_of("dmmv_conventions", "threads"),
        *map(header, headers),
    ]


def header(name: str) -> str:
    """A fixed part of every source, without its own inclusions."""
    return header_of("diffstack_mmv.control.native", name)


def by_kind(name: str, each: str, count: int) -> str:
    """A function that calls that of the kind of its time."""
    calls = "\n".join(
        f"  if (cost_kind[t] == {kind}) return {each.format(kind)}(x, u, q, y);"
        for kind in range(count)
    )
    return f"{TEMPLATE} void {name}(int t, {POINT}, const Real* q, V* y) {{\n{calls}\n}}"


def plain(signature: str, program: Program, numbers: str, nodes: Sequence[Node]) -> str:
    """A function of plain numbers."""
    body = function(f"static void {signature}", program, numbers, into("y", nodes))
    return body.replace("{\n", "{\n  using V = Real;\n", 1)


def flag(name: str, value: bool) -> str:
    """A truth that is known when the library is compiled."""
    return f"static constexpr bool {name} = {literal(value)};"
