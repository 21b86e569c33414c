"""Keeps the angles of one problem out of the sines of its batch mates, in a compiled graph.

A vectorised sine reduces its argument by 2π in one of several ways, and takes the slowest one for
the whole vector if one entry is large or not finite. The entries beside it, which belong to other
problems, then differ in their last digit. Here a sine only ever sees arguments of the fast way.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import fx
from torch._inductor.custom_graph_pass import CustomGraphPass, get_hash_for_files

ATEN = torch.ops.aten
SINES = (ATEN.sin.default, ATEN.cos.default, ATEN.tan.default)
FAST = {torch.float32: 100.0, torch.float64: 14.0}
"""Argument in rad up to which the fast way is taken, a little below 125 and 15."""
TURN = 6.28125  # few digits, so that its multiples are exact
TURN_REST = 1.9353071795864769e-3  # 2π - TURN


class SeparateLanes(CustomGraphPass):
    """Replaces the sines, cosines and tangents of a graph by those of `separate`."""

    def __call__(self, graph: fx.Graph) -> None:
        """Change the graph in place."""
        for sine in SINES:
            for node in graph.find_nodes(op="call_function", target=sine):
                self._replace(graph, node, sine)

    def uuid(self) -> Any:
        """Hash of this file: graphs that are kept on disk belong to one form of it."""
        return get_hash_for_files((__file__,))

    def _replace(self, graph: fx.Graph, node: fx.Node, sine: Callable[..., Any]) -> None:
        angle = node.args[0]
        fast = FAST.get(node.meta["val"].dtype)
        if fast is None:
            return

        def insert(function: Callable[..., Any], *arguments: Any) -> fx.Node:
            return graph.call_function(function, arguments)

        with graph.inserting_before(node):
            result = separate(insert, sine, angle, fast)
        node.replace_all_uses_with(result)
        graph.erase_node(node)


def separate(call: Callable[..., Any], sine: Callable[..., Any], angle: Any, fast: float) -> Any:
    """The sine of an angle by operations that treat each entry by itself.

    Angles beyond `fast` are reduced by whole turns first, to the precision of the angle; those of
    which no digit after the comma is known count as zero. What is not finite gives NaN.

    Args:
        call: Applies an operation of ATen: (operation, arguments) -> result.
        sine: The operation: sine, cosine or tangent.
        angle: In rad.
        fast: Angle up to which nothing is reduced, in rad.
    """
    size = call(ATEN.abs.default, angle)
    turns = call(ATEN.round.default, call(ATEN.mul.Tensor, angle, 1 / (TURN + TURN_REST)))
    rest = call(ATEN.sub.Tensor, angle, call(ATEN.mul.Tensor, turns, TURN))
    rest = call(ATEN.sub.Tensor, rest, call(ATEN.mul.Tensor, turns, TURN_REST))
    rest = call(ATEN.where.self, call(ATEN.le.Scalar, size, fast), angle, rest)
    known = call(ATEN.le.Scalar, call(ATEN.abs.default, rest), fast)
    rest = call(ATEN.where.ScalarOther, known, rest, 0.0)
    finite = call(ATEN.lt.Scalar, size, torch.inf)
    return call(ATEN.where.ScalarOther, finite, call(sine, rest), torch.nan)
