"""C++ for the numbers that stages read: from the parameters once per solve, and gradients back."""

from collections.abc import Sequence

from diffstack_mmv.control.native.code import function, into, table
from diffstack_mmv.control.native.derivative import gradient
from diffstack_mmv.control.native.derived import weighted_gradient
from diffstack_mmv.control.native.library import POINT, TEMPLATE, by_kind
from diffstack_mmv.control.native.repetition import OF_A_TERM, with_entries
from diffstack_mmv.control.native.scalar import LEAF, Node, Program
from diffstack_mmv.control.native.stages import Stage, StagedProblem


def prelude(problem: StagedProblem) -> str:
    """The numbers of a solve; those that are parameters, thousands for many agents, by a table."""
    program, signature = problem.parameters, "prelude(const Real* p, Real* y)"
    copied = _copied_parameters(program, problem.numbers)
    others = [
        (place, node)
        for k, (place, node) in enumerate(into("y", problem.numbers))
        if k not in copied
    ]
    body = function(f"static void {signature}", program, "p", others)
    body = body.replace("{\n", "{\n  using V = Real;\n", 1).removesuffix("}")
    return "\n".join(
        [
            f"static constexpr int COPIED = {len(copied)};",
            table("int", "copied_to", list(copied)),
            table("int", "copied_from", list(copied.values())),
            body,
            "  for (int i = 0; i < COPIED; ++i) y[copied_to[i]] = p[copied_from[i]];",
            "}",
        ]
    )


def _copied_parameters(program: Program, numbers: Sequence[Node]) -> dict[int, int]:
    """Which number is which parameter."""
    operations = (program.operations[node] for node in numbers)
    return {k: each[2] for k, each in enumerate(operations) if each[0] == LEAF}


def prelude_adjoint(program: Program, numbers: Sequence[Node], parameters: int) -> str:
    """Gradient of Σ w_k (number k) by the parameters, added to what is there."""
    copied = _copied_parameters(program, numbers)
    weights: dict[Node, Node] = {}
    for k, number in enumerate(numbers):
        if k not in copied:
            weight = program.leaf("w", k)
            before = weights.get(number)
            weights[number] = weight if before is None else program.apply("add", before, weight)
    leaves = [program.leaf("p", k) for k in range(parameters)]
    slopes = gradient(program, weights, leaves)
    signature = "static void prelude_adjoint(const Real* p, const Real* w, Real* y)"
    outputs = [(place, node) for place, node in into("y", slopes) if program.value(node) != 0]
    body = function(signature, program, "pw", outputs)
    return "\n".join(
        [
            table("int", "weighed", list(copied)),
            table("int", "weighed_for", list(copied.values())),
            body.replace("{\n", "{\n  using V = Real;\n", 1).removesuffix("}"),
            f"  for (int i = 0; i < {len(copied)}; ++i) y[weighed_for[i]] += w[weighed[i]];",
            "}",
        ]
    )


def number_gradients(step: Stage, costs: Sequence[Stage]) -> list[str]:
    """Gradients of the stages by their numbers q."""
    signature = f"{TEMPLATE} void step_numbers_gradient({POINT}, const V* l, const Real* q, V* y)"
    whole = function(signature, step.program, "q", into("y", by_numbers(step, "q")))
    return [whole, *cost_number_gradients(costs)]


def cost_number_gradients(costs: Sequence[Stage]) -> list[str]:
    """Gradients of costs by their numbers q."""
    parts = []
    for kind, cost in enumerate(costs):
        signature = f"{TEMPLATE} void cost_{kind}_numbers({POINT}, const Real* q, V* y)"
        whole = function(signature, cost.program, "q", into("y", by_numbers(cost, "q")))
        like = cost.repeated
        added = [] if like is None else by_numbers(like.term, OF_A_TERM)
        parts.append(with_entries(whole, cost, added))
    return [
        *parts,
        table("int", "kind_numbers", [cost.numbers for cost in costs]),
        by_kind("cost_numbers_gradient", "cost_{}_numbers", len(costs)),
    ]


def by_numbers(stage: Stage, name: str) -> list[Node]:
    """Gradient of a stage by its own numbers, leaves of this name."""
    leaves = [stage.program.leaf(name, k) for k in range(stage.own_numbers)]
    return weighted_gradient(stage, leaves)
