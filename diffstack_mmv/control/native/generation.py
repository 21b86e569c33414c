"""The C++ source of a solver for one problem."""

from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import NamedTuple

from diffstack_mmv.control.native.code import function, literal
from diffstack_mmv.control.native.derivative import gradient
from diffstack_mmv.control.native.scalar import Node, Program
from diffstack_mmv.control.native.stages import Sizes, Stage, StagedProblem
from diffstack_mmv.types import SolverStatus

HEADERS = ("numbers", "small", "stage", "solver")
ENTRIES = {"solve": ("solve",), "adjoint": ("adjoint",)}
"""Headers that each library has besides, with its functions for the caller."""


class Derived(NamedTuple):
    """A stage with its gradient by state and control, weighted by leaves ("l", i)."""

    stage: Stage
    gradient: tuple[Node, ...]
    active: tuple[int, ...]  # columns of the Jacobian of the stage that are not constant
    constants: tuple[tuple[float, ...], ...]  # that Jacobian, zero where it is not constant


def source(problem: StagedProblem, library: str, real: str) -> str:
    """A whole library: the generated functions of the problem between fixed headers.

    Args:
        problem: The stages.
        library: "solve" or "adjoint".
        real: "float" or "double".
    """
    status = {name: int(SolverStatus[name]) for name in ("CONVERGED", "STALLED", "NOT_FINITE")}
    status["LIMIT"] = int(SolverStatus.ITERATION_LIMIT)
    parts = [
        "#include <cmath>",
        "#include <type_traits>",
        "#include <utility>",
        f"typedef {real} Real;",
        *(f"#define DMMV_{name} {value}" for name, value in status.items()),
        *map(_header, HEADERS),
        *_problem(problem, library == "adjoint"),
        *map(_header, ENTRIES[library]),
    ]
    return "\n".join(parts) + "\n"


def _header(name: str) -> str:
    text = files(__package__).joinpath(f"{name}.hpp").read_text()
    return "\n".join(line for line in text.splitlines() if not line.startswith(('#include "', "#pragma")))


def _problem(problem: StagedProblem, adjoint: bool) -> list[str]:
    n, m, steps, parameters = problem.sizes
    widest = max(len(numbers) for numbers in problem.cost_numbers)
    step = derived(problem.step, problem.sizes)
    costs = [derived(cost, problem.sizes) for cost in problem.costs]
    lines = [
        "using namespace dmmv;",
        "struct Problem {",
        f"static constexpr int n = {n}, m = {m}, T = {steps}, PARAMETERS = {parameters};",
        f"static constexpr int NUMBERS = {len(problem.numbers)}, COST_NUMBERS = {widest};",
        f"static constexpr int STEP_NUMBERS = {len(problem.step_numbers)};",
        _table("int", "step_numbers", problem.step_numbers),
        _table("int", "cost_kind", problem.kinds),
        _rows("cost_numbers", problem.cost_numbers, widest),
        _prelude(problem),
        *_step(step, problem.sizes),
        *(part for kind, cost in enumerate(costs) for part in _cost(kind, cost, problem.sizes)),
        *_by_kind(len(costs)),
    ]
    if adjoint:
        lines += [_prelude_adjoint(problem), *_number_gradients(step, costs)]
    return [*lines, "};"]


def derived(stage: Stage, sizes: Sizes) -> Derived:
    """Differentiate a stage."""
    n, m, *_ = sizes
    program = stage.program
    inputs = [program.leaf("x", i) for i in range(n)] + [program.leaf("u", j) for j in range(m)]
    one = program.constant(1.0)
    jacobian = [gradient(program, {output: one}, inputs) for output in stage.outputs]
    values = [[program.value(entry) for entry in row] for row in jacobian]
    constants = tuple(tuple(0.0 if v is None else v for v in row) for row in values)
    active = tuple(i for i in range(n + m) if any(row[i] is None for row in values))
    return Derived(stage, tuple(weighted_gradient(stage, inputs)), active, constants)


def weighted_gradient(stage: Stage, inputs: Sequence[Node]) -> list[Node]:
    """Gradient of Σ l_i y_i by some leaves; of a cost, which has no weight, of its value."""
    program, outputs = stage.program, stage.outputs
    if stage.is_cost:
        return gradient(program, {outputs[0]: program.constant(1.0)}, inputs)
    return gradient(program, weighted(program, outputs, "l"), inputs)


def weighted(program: Program, outputs: Iterable[Node], name: str) -> dict[Node, Node]:
    """A weight, leaf (name, i), of each output; those of one node are added."""
    weights: dict[Node, Node] = {}
    for index, output in enumerate(outputs):
        weight = program.leaf(name, index)
        before = weights.get(output)
        weights[output] = weight if before is None else program.apply("add", before, weight)
    return weights


def _step(step: Derived, sizes: Sizes) -> list[str]:
    n, m, *_ = sizes
    program, outputs = step.stage.program, step.stage.outputs
    value = "template <class V> static void step(const V* x, const V* u, const Real* q, V* y)"
    slope = (
        "template <class V> static void step_gradient"
        "(const V* x, const V* u, const Real* l, const Real* q, V* y)"
    )
    return [
        function(value, program, "q", _into("y", outputs)),
        function(slope, program, "ql", _into("y", step.gradient)),
        _table("int", "step_active", step.active or (-1,)),
        _table("Real", "step_constant", [entry for row in step.constants for entry in row]),
        f"""
static void step_jacobian(const Real* x, const Real* u, const Real* q, Real* A, Real* B) {{
  Real J[n * (n + m)], y[n];
  std::memcpy(J, step_constant, sizeof(J));
  dmmv::columns<n, m, n>(x, u, step_active, [&](const auto* x, const auto* u, auto* y) {{ step(x, u, q, y); }}, y, J);
  dmmv::split_jacobian<n, m>(J, A, B);
}}
static void add_step_hessian(const Real* x, const Real* u, const Real* l, const Real* q, Real* xx, Real* ux, Real* uu) {{
  Real H[{(n + m) ** 2}] = {{}}, g[{n + m}];
  dmmv::columns<n, m, {n + m}>(x, u, step_active, [&](const auto* x, const auto* u, auto* y) {{ step_gradient(x, u, l, q, y); }}, g, H);
  dmmv::add_blocks<n, m>(H, xx, ux, uu);
}}""",
    ]


def _cost(kind: int, cost: Derived, sizes: Sizes) -> list[str]:
    n, m, *_ = sizes
    program, outputs = cost.stage.program, cost.stage.outputs
    value = f"template <class V> static V cost_{kind}(const V* x, const V* u, const Real* q)"
    slope = f"template <class V> static void cost_gradient_{kind}(const V* x, const V* u, const Real* q, V* y)"
    both = [*_into("y", cost.gradient), (f"y[{n + m}]", outputs[0])]
    return [
        function(value, program, "q", [("const V y", outputs[0])])[:-1] + "  return y;\n}",
        function(slope, program, "q", both),
        _table("int", f"cost_active_{kind}", cost.active or (-1,)),
        f"""
static Real cost_model_{kind}(const Real* x, const Real* u, const Real* q, Real* c_x, Real* c_u, Real* xx, Real* ux, Real* uu) {{
  Real H[{(n + m + 1) * (n + m)}] = {{}}, g[{n + m + 1}];
  dmmv::columns<n, m, {n + m + 1}>(x, u, cost_active_{kind}, [&](const auto* x, const auto* u, auto* y) {{ cost_gradient_{kind}(x, u, q, y); }}, g, H);
  std::memset(xx, 0, n * n * sizeof(Real));
  std::memset(ux, 0, m * n * sizeof(Real));
  std::memset(uu, 0, m * m * sizeof(Real));
  dmmv::add_blocks<n, m>(H, xx, ux, uu);
  std::memcpy(c_x, g, n * sizeof(Real));
  std::memcpy(c_u, g + n, m * sizeof(Real));
  return g[{n + m}];
}}""",
    ]


def _by_kind(count: int) -> list[str]:
    model = "x, u, q, c_x, c_u, xx, ux, uu"
    return [
        "template <class V> static V cost(int t, const V* x, const V* u, const Real* q) {",
        *(f"  if (cost_kind[t] == {kind}) return cost_{kind}(x, u, q);" for kind in range(count - 1)),
        f"  return cost_{count - 1}(x, u, q);\n}}",
        "static Real cost_model(int t, const Real* x, const Real* u, const Real* q, Real* c_x, Real* c_u, Real* xx, Real* ux, Real* uu) {",
        *(f"  if (cost_kind[t] == {kind}) return cost_model_{kind}({model});" for kind in range(count - 1)),
        f"  return cost_model_{count - 1}({model});\n}}",
    ]


def _prelude(problem: StagedProblem) -> str:
    outputs = _into("y", problem.numbers)
    body = function("static void prelude(const Real* p, Real* y)", problem.parameters, "p", outputs)
    return body.replace("{\n", "{\n  using V = Real;\n", 1)


def _prelude_adjoint(problem: StagedProblem) -> str:
    """Gradient of Σ w_k (number k) by the parameters, added to what is there."""
    program = problem.parameters
    weights = weighted(program, problem.numbers, "w")
    leaves = [program.leaf("p", k) for k in range(problem.sizes.parameters)]
    slopes = gradient(program, weights, leaves)
    signature = "static void prelude_adjoint(const Real* p, const Real* w, Real* y)"
    outputs = [(place, node) for place, node in _into("y", slopes) if program.value(node) != 0]
    return function(signature, program, "pw", outputs).replace("{\n", "{\n  using V = Real;\n", 1)


def _number_gradients(step: Derived, costs: Sequence[Derived]) -> list[str]:
    """Gradients of the stages by their numbers q."""
    parts = []
    stages = [("step", step.stage), *((f"cost_{k}", cost.stage) for k, cost in enumerate(costs))]
    for name, stage in stages:
        leaves = [stage.program.leaf("q", k) for k in range(stage.numbers)]
        slopes = weighted_gradient(stage, leaves)
        signature = (
            f"template <class V> static void {name}_numbers{'_gradient' if name == 'step' else ''}"
            "(const V* x, const V* u, const V* l, const Real* q, V* y)"
        )
        parts.append(function(signature, stage.program, "q", _into("y", slopes)))
    kinds = len(stages) - 1
    arguments = "x, u, l, q, y"
    counts = [cost.stage.numbers for cost in costs]
    return [
        *parts,
        _table("int", "kind_numbers", counts),
        "static int count_of_cost(int t) { return kind_numbers[cost_kind[t]]; }",
        "template <class V> static void cost_numbers_gradient(int t, const V* x, const V* u, const V* l, const Real* q, V* y) {",
        *(f"  if (cost_kind[t] == {kind}) return cost_{kind}_numbers({arguments});" for kind in range(kinds)),
        "}",
    ]


def _into(array: str, nodes: Iterable[Node]) -> list[tuple[str, Node]]:
    return [(f"{array}[{index}]", node) for index, node in enumerate(nodes)]


def _table(kind: str, name: str, values: Sequence[float]) -> str:
    entries = ", ".join(str(v) if kind == "int" else literal(v) for v in values) or "0"
    return f"static constexpr {kind} {name}[] = {{{entries}}};"


def _rows(name: str, rows: Sequence[Sequence[int]], width: int) -> str:
    padded = ([*row, *[0] * (width - len(row))] or [0] for row in rows)
    body = ", ".join("{" + ", ".join(map(str, row)) + "}" for row in padded)
    return f"static constexpr int {name}[{len(rows)}][{max(width, 1)}] = {{{body}}};"
