"""Which problems are linear-quadratic, as their operations tell."""

from collections.abc import Iterable, Sequence

from diffstack_mmv.control.native.code import OPERATORS
from diffstack_mmv.control.native.derived import Derived
from diffstack_mmv.control.native.scalar import LEAF, Node, Program, arguments_of, needed


def is_linear_quadratic(step: Derived, costs: Sequence[Derived]) -> bool:
    """Whether derivatives depend on parameters alone: the Jacobian of a step, Hessians of costs.

    That alone would not do: |u| and the floor of x have kinks and jumps that no derivative tells.
    """
    if any(cost.hessian is None or cost.stage.repeated for cost in costs):
        return False
    if not all(_is_arithmetic(part.stage.program, part.stage.outputs) for part in (step, *costs)):
        return False
    each = [(step, step.jacobian), *((cost, cost.hessian or ()) for cost in costs)]
    return not any(_sees_trajectory(stage.stage.program, nodes) for stage, nodes in each)


def _sees_trajectory(program: Program, nodes: Iterable[Node]) -> bool:
    return any(_is_trajectory(program, node) for node in needed(program, nodes))


def _is_trajectory(program: Program, node: Node) -> bool:
    operation = program.operations[node]
    return operation[0] == LEAF and operation[1] in "xu"


def _is_arithmetic(program: Program, nodes: Iterable[Node]) -> bool:
    """Whether states and controls are only added, multiplied and chosen among by parameters."""
    seen: set[Node] = set()
    for node in needed(program, nodes):
        arguments = arguments_of(program, node)
        if _is_trajectory(program, node):
            seen.add(node)
        elif not seen.isdisjoint(arguments):
            name = program.operations[node][0]
            by_parameters = name == "where" and arguments[0] not in seen
            if name not in OPERATORS and not by_parameters:
                return False
            seen.add(node)
    return True
