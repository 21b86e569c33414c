"""The C++ source of a solver for one problem."""

from collections.abc import Sequence
from enum import StrEnum

from diffstack_mmv.control.native.code import function, into, rows_of, table
from diffstack_mmv.control.native.derived import Derived, derived
from diffstack_mmv.control.native.library import (
    POINT,
    TEMPLATE,
    by_kind,
    flag,
    header,
    opening,
    plain,
)
from diffstack_mmv.control.native.linearity import is_linear_quadratic
from diffstack_mmv.control.native.own_numbers import number_gradients, prelude, prelude_adjoint
from diffstack_mmv.control.native.repetition import (
    Summand,
    added_terms,
    with_sums,
)
from diffstack_mmv.control.native.scalar import Node, Program, needed
from diffstack_mmv.control.native.stages import Sizes, Stage, StagedProblem
from diffstack_mmv.types import SolverStatus

LANES = 8  # of the numbers with slopes, as in numbers.hpp
SLOPES_COST = 3  # operations on packs that one on numbers with slopes takes


class Library(StrEnum):
    """What is compiled for a problem: its solver, and the gradient of the solution."""

    SOLVE = "solve"
    ADJOINT = "adjoint"


HEADERS = ("numbers", "small", "stage", "solver")
ENTRIES = {Library.SOLVE: ("solve",), Library.ADJOINT: ("adjoint", "differentiate")}
LINEAR = ("lanes", "lane_recursion", "pivoting")
LINEAR_ENTRIES = {
    Library.SOLVE: (*LINEAR, "interior", "linear_quadratic", "solve"),
    Library.ADJOINT: ("adjoint", *LINEAR, "lane_adjoint", "differentiate"),
}
"""Headers that each library has besides, with its functions for the caller; those of
linear-quadratic problems differ."""


def source(problem: StagedProblem, library: str, real: str) -> str:
    """A whole library: the generated functions of the problem between fixed headers.

    Args:
        problem: The stages.
        library: A `Library`.
        real: "float" or "double".
    """
    names = "CONVERGED", "STALLED", "NOT_FINITE", "UNBOUNDED"
    status = {name: int(SolverStatus[name]) for name in names}
    status["LIMIT"] = int(SolverStatus.ITERATION_LIMIT)
    step = derived(problem.step, problem.sizes)
    costs = [derived(cost, problem.sizes) for cost in problem.costs]
    is_linear = is_linear_quadratic(step, costs)
    parts = [
        *(f"#define DMMV_{name} {value}" for name, value in status.items()),
        *(["#define DMMV_LINEAR_QUADRATIC"] if is_linear else []),
        *opening(real, *HEADERS),
        *_problem(problem, step, costs, library == Library.ADJOINT),
        *map(header, (LINEAR_ENTRIES if is_linear else ENTRIES)[Library(library)]),
    ]
    return "\n".join(parts) + "\n"


def _problem(
    problem: StagedProblem, step: Derived, costs: Sequence[Derived], adjoint: bool
) -> list[str]:
    n, m, steps, parameters = problem.sizes
    widest = max(len(numbers) for numbers in problem.cost_numbers)
    lines = [
        "using namespace dmmv;",
        "struct Problem {",
        f"static constexpr int n = {n}, m = {m}, T = {steps}, PARAMETERS = {parameters};",
        f"static constexpr int NUMBERS = {len(problem.numbers)}, COST_NUMBERS = {widest};",
        f"static constexpr int STEP_NUMBERS = {len(problem.step_numbers)};",
        table("int", "step_numbers", problem.step_numbers),
        table("int", "cost_kind", problem.kinds),
        rows_of("cost_numbers", problem.cost_numbers, widest),
        table("int", "cost_alike", _first_alike(problem)),
        prelude(problem),
        *_step(step),
        *_costs(costs, problem.sizes),
    ]
    if adjoint:
        known = problem.parameters, problem.numbers, parameters
        gradients = number_gradients(problem.step, problem.costs)
        lines += [prelude_adjoint(*known), *gradients]
    return [*lines, "};"]


def _first_alike(problem: StagedProblem) -> list[int]:
    """The first time that costs the same as each time, numbers included."""
    first: dict[tuple[int, tuple[int, ...]], int] = {}
    each = zip(problem.kinds, problem.cost_numbers, strict=True)
    return [first.setdefault(known, time) for time, known in enumerate(each)]


def is_short(program: Program, written: Sequence[Node] | None, instead: Sequence[Node]) -> bool:
    """Whether derivatives take less when written out than by numbers with eight slopes each."""
    if written is None:
        return False
    columns = -(-(len(written) // max(len(instead), 1)) // LANES)
    return len(needed(program, written)) <= SLOPES_COST * columns * len(needed(program, instead))


def _step(step: Derived) -> list[str]:
    program = step.stage.program
    value = f"{TEMPLATE} void step({POINT}, const Real* q, V* y)"
    slope = f"{TEMPLATE} void step_gradient({POINT}, const Real* l, const Real* q, V* y)"
    jacobian_written = is_short(program, step.jacobian, step.stage.outputs)
    hessian_written = is_short(program, step.hessian, step.gradient)
    entries = step.jacobian if jacobian_written else ()
    curvature = step.hessian if hessian_written and step.hessian else ()
    point = POINT.replace("V", "Real")
    return [
        flag("JACOBIAN_WRITTEN", jacobian_written),
        flag("HESSIAN_WRITTEN", hessian_written),
        plain(f"step_jacobian({point}, const Real* q, Real* y)", program, "q", entries),
        plain(
            f"step_hessian({point}, const Real* l, const Real* q, Real* y)",
            program,
            "ql",
            curvature,
        ),
        function(value, program, "q", into("y", step.stage.outputs)),
        # with the values: their derivatives come with those of the gradient
        function(slope, program, "ql", into("y", [*step.gradient, *step.stage.outputs])),
        f"static constexpr int STEP_ACTIVE = {len(step.active)};",
        table("int", "step_active", step.active),
        table("Real", "step_constant", [entry for row in step.constants for entry in row]),
    ]


def _costs(costs: Sequence[Derived], sizes: Sizes) -> list[str]:
    parts = []
    for kind, cost in enumerate(costs):
        program, (output,) = cost.stage.program, cost.stage.outputs
        value = f"{TEMPLATE} void cost_{kind}({POINT}, const Real* q, V* y)"
        slope = f"{TEMPLATE} void cost_gradient_{kind}({POINT}, const Real* q, V* y)"
        both = [*cost.gradient, output]
        added = _of_each_term(cost.stage, sizes)
        whole = function(value, program, "q", into("y", [output]))
        parts.append(with_sums(whole, cost.stage, added[-1:]))
        whole = function(slope, program, "q", into("y", both))
        parts.append(with_sums(whole, cost.stage, [] if cost.term else added))
        parts.append(added_terms(kind, cost.stage, _term_entries(cost, sizes)))
    widest = max(len(cost.active) for cost in costs)
    written = all(is_short(cost.stage.program, cost.hessian, cost.gradient) for cost in costs)
    for kind, cost in enumerate(costs):
        signature = f"{TEMPLATE} void cost_hessian_{kind}({POINT}, const Real* q, V* y)"
        entries = into("y", cost.hessian or ()) if written else []
        parts.append(function(signature, cost.stage.program, "q", entries))
    return [
        *parts,
        by_kind("cost", "cost_{}", len(costs)),
        by_kind("cost_gradient", "cost_gradient_{}", len(costs)),
        by_kind("cost_hessian", "cost_hessian_{}", len(costs)),
        by_kind("add_terms", "add_terms_{}", len(costs)),
        flag("COST_WRITTEN", written),
        flag("TERMS_WRITTEN", any(cost.term for cost in costs)),
        table("int", "cost_columns", [len(cost.active) for cost in costs]),
        rows_of("cost_active", [cost.active for cost in costs], widest),
    ]


def _of_each_term(stage: Stage, sizes: Sizes) -> list[Node]:
    """Gradient and value of a like term."""
    if stage.repeated is None:
        return []
    term = derived(stage.repeated.term, sizes)
    return [*term.gradient, *term.stage.outputs]


def _term_entries(cost: Derived, sizes: Sizes) -> list[Summand]:
    """Gradient, value and Hessian of a like term, one behind the other."""
    term, k = cost.term, sizes.n + sizes.m
    if term is None or term.hessian is None:
        return []
    entries = [Summand((i,), node) for i, node in enumerate((*term.gradient, *term.stage.outputs))]
    for i in range(k):
        entries.append(Summand((k + 1 + i * k + i,), term.hessian[i * k + i]))
        for j in range(i):
            places = k + 1 + i * k + j, k + 1 + j * k + i
            entries.append(Summand(places, term.hessian[i * k + j]))
    return entries
