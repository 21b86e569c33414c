"""C++ for second derivatives of a step: along eight directions at once, or of eight rows."""

from collections.abc import Iterable, Sequence

from diffstack_mmv.control.native.code import Writer, function, into
from diffstack_mmv.control.native.derivative import gradient
from diffstack_mmv.control.native.derived import LONGEST_GRADIENT, weighted
from diffstack_mmv.control.native.scalar import CONSTANT, LEAF, Node, Program, needed
from diffstack_mmv.control.native.stages import Stage

WEIGHTS = "l"


class MixedWriter(Writer):
    """Writes operations whose types the compiler finds: see `Weighted` in moments.hpp.

    Args:
        program: The program.
    """

    def __init__(self, program: Program) -> None:
        super().__init__(program, "q")
        self.weighted: set[Node] = set()

    def lines(self, wanted: Iterable[Node]) -> list[str]:
        """Definitions of all that some nodes need."""
        lines = []
        for node in needed(self.program, wanted):
            name, *arguments = self.program.operations[node]
            if name == CONSTANT:
                continue
            self._type(node)  # notes which nodes are plain numbers
            if name == LEAF:
                depends = arguments[0] == WEIGHTS
            else:
                depends = any(each in self.weighted for each in arguments)
            if depends:
                self.weighted.add(node)
            lines.append(f"  const auto {self.name(node)} = {self._expression(node)};")
        return lines

    def _choice(self, node: Node, condition: Node, a: Node, b: Node) -> str:
        if node in self.weighted:
            return f"either({', '.join(map(self.name, (condition, a, b)))})"
        return super()._choice(node, condition, a, b)


def bend(stage: Stage, inputs: Sequence[Node], active: Sequence[int], learns: bool) -> str:
    """The function `bend`: adds Σ_d ∂/∂d (weights of direction d · gradient of the outputs).

    Args:
        stage: A step.
        inputs: Its states and controls, as leaves.
        active: Those by which it is differentiated.
        learns: Whether its numbers are differentiated by as well.
    """
    program = stage.program
    numbers = [program.leaf("q", k) for k in range(stage.numbers)] if learns else []
    wanted = [inputs[column] for column in active] + numbers
    places = [f"z[{column}]" for column in active]
    places += [f"numbers[{k}]" for k in range(len(numbers))]
    slopes = gradient(program, weighted(program, stage.outputs, WEIGHTS), wanted)
    writer = MixedWriter(program)
    lines = writer.lines(slopes)
    ends = [
        f"  {place} += slopes({writer.name(slope)});"
        for place, slope in zip(places, slopes, strict=True)
        if slope in writer.weighted
    ]
    point = "const Dual<Pack>* x, const Dual<Pack>* u, const Pack* l, const Real* q"
    head = f"static void bend({point}, Real* z, Real* numbers) {{\n  using V = Dual<Pack>;"
    return "\n".join([head, *lines, *ends, "}"])


def weigh_numbers(stage: Stage, learns: bool) -> str:
    """The function `weigh_numbers`: adds the gradient of l · outputs by the numbers."""
    program = stage.program
    leaves = [program.leaf("q", k) for k in range(stage.numbers)] if learns else []
    slopes = gradient(program, weighted(program, stage.outputs, WEIGHTS), leaves)
    point = "const Real* x, const Real* u, const Real* l, const Real* q, Real* numbers"
    outputs = [
        (f"numbers[{k}]", program.apply("add", program.leaf("numbers", k), each))
        for k, each in enumerate(slopes)
        if program.value(each) != 0
    ]
    body = function(f"static void weigh_numbers({point})", program, "q", outputs)
    return body.replace("{\n", "{\n  using V = Real;\n", 1)


def abreast(
    stage: Stage, inputs: Sequence[Node], jacobian: Sequence[Node], learns: bool
) -> tuple[str, ...]:
    """The functions `step_abreast` and `pull_abreast` of eight rows; none where they are too long.

    The first gives the step and its Jacobian, the second the gradient of s · outputs + G · Jacobian
    by inputs, and adds the one by the numbers.

    Args:
        stage: A step.
        inputs: Its states and controls, as leaves.
        jacobian: Of the outputs by the inputs, row by row.
        learns: Whether its numbers are differentiated by as well.
    """
    program = stage.program
    if len(needed(program, jacobian)) > LONGEST_GRADIENT:
        return ()
    numbers = [program.leaf("q", k) for k in range(stage.numbers)] if learns else []
    weights = weighted(program, stage.outputs, "s")
    for entry, weight in weighted(program, jacobian, "G").items():
        before = weights.get(entry)
        weights[entry] = weight if before is None else program.apply("add", before, weight)
    slopes = gradient(program, weights, [*inputs, *numbers])
    sums = enumerate(slopes[len(inputs) :])
    given = "const Pack* x, const Pack* u, const Real* q"
    forward = f"static void step_abreast({given}, Pack* y, Pack* J)"
    backward = (
        f"static void pull_abreast({given}, const Pack* s, const Pack* G, Pack* z, Pack* sums)"
    )
    outputs = [*into("y", stage.outputs), *into("J", jacobian)]
    pulled = into("z", slopes[: len(inputs)]) + [
        (f"sums[{k}]", program.apply("add", program.leaf("sums", k), each))
        for k, each in sums
        if program.value(each) != 0
    ]
    written = (function(forward, program, "q", outputs), function(backward, program, "q", pulled))
    return tuple(each.replace("{\n", "{\n  using V = Pack;\n", 1) for each in written)
