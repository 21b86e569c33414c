"""Gaussian controls through a model to the moments of its positions, in a generated library.

What torch does step by step on tensors of a few entries, with the second derivatives of the model
in the backward pass, is one call here: eight rows at a time where the derivatives of a step are
short, else a row at a time with eight directions of differentiation at once.
"""

import weakref
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.control.native.bending import abreast, bend, weigh_numbers
from diffstack_mmv.control.native.code import function, into, literal, table
from diffstack_mmv.control.native.derivative import gradient
from diffstack_mmv.control.native.generation import LANES
from diffstack_mmv.control.native.library import POINT, TEMPLATE, header, opening, plain
from diffstack_mmv.control.native.modules import ModelWorkshop, Part, Ready
from diffstack_mmv.control.native.own_numbers import prelude_adjoint
from diffstack_mmv.control.native.solver import QUICKLY
from diffstack_mmv.control.native.stages import StagedStep
from dmmv_conventions.libraries import brought, counts, pointers, within_reach

PARTS = (
    Part("dmmv_moments", ("-DDMMV_MOMENTS_ALONE",)),
    Part("dmmv_moments_adjoint", ("-DDMMV_ADJOINT_ALONE", "-fno-gcse", *QUICKLY)),
)
"""That of DiffGM3 is built in 11 instead of 25 s: the search that the adjoint can do without, which
is no slower for it, makes the moments faster by a third."""
Moments = tuple[Float[Tensor, "N T 2"], Float[Tensor, "N T 2 2"]]


def moments(
    dynamics: nn.Module,
    start: Float[Tensor, "N n"],
    covariance: Float[Tensor, "N n n"],
    controls: Float[Tensor, "N T m"],
    scale: Float[Tensor, "N T m m"],
) -> Moments | None:
    """Mean and covariance of the first two states at the times 1 .. T; None without a library.

    Nor is there one where the rows are of other shapes, or of different types.

    The mean is the roll-out of the mean controls, the covariance follows it to first order: Σ⁺ = A
    Σ Aᵀ + B L (B L)ᵀ. Can be differentiated once; a second derivative is refused.

    Args:
        dynamics: One step, (state, control) -> next state; every row on its own.
        start: Mean of the first state.
        covariance: Of the first state, symmetric.
        controls: Mean controls.
        scale: Cholesky factors L of their covariances.
    """
    rows = start, covariance, controls, scale
    if not _fit(*rows):
        return None
    workshop = _WORKSHOPS.get(dynamics)
    if workshop is None:
        workshop = _WORKSHOPS[dynamics] = ModelWorkshop(
            f"the decoder for {type(dynamics).__name__}", PARTS
        )
    sizes = start.shape[-1], controls.shape[-1]
    ready = workshop.library(dynamics, *sizes, start.dtype, source)
    if ready is None:
        return None
    found: Moments = _Moments.apply(ready, ready.numbers, *rows)  # type: ignore[no-untyped-call]
    return found


def _fit(start: Tensor, covariance: Tensor, controls: Tensor, scale: Tensor) -> bool:
    """Whether all are rows of the same number, of which a library knows no other than the first."""
    if not within_reach(start) or start.dim() != 2 or controls.dim() != 3 or not controls.numel():
        return False
    (count, n), (*lead, m) = start.shape, controls.shape
    fits = n >= 2 and lead[0] == count
    fits = fits and covariance.shape == (count, n, n) and scale.shape == (*lead, m, m)
    return fits and all(each.dtype == start.dtype for each in (covariance, controls, scale))


_WORKSHOPS: weakref.WeakKeyDictionary[nn.Module, ModelWorkshop] = weakref.WeakKeyDictionary()


def source(problem: StagedStep, learns: bool, real: str) -> str:
    """A whole library.

    Args:
        problem: A step.
        learns: Whether the parameters have a gradient.
        real: "float" or "double".
    """
    fixed, entry = header("moments").split("#pragma GCC visibility push(default)")
    return "\n".join(
        [
            *opening(real, "numbers", "small", "stage", "abreast"),
            fixed,
            "using namespace dmmv;",
            *_problem(problem, learns),
            "#pragma GCC visibility push(default)",
            entry,
        ]
    )


def _problem(problem: StagedStep, learns: bool) -> list[str]:
    n, m, stage = problem.state, problem.inputs, problem.step
    program, one = stage.program, stage.program.constant(1.0)
    inputs = [program.leaf("x", i) for i in range(n)] + [program.leaf("u", j) for j in range(m)]
    jacobian = [gradient(program, {output: one}, inputs) for output in stage.outputs]
    values = [[program.value(entry) for entry in row] for row in jacobian]
    active = [column for column in range(n + m) if any(row[column] is None for row in values)]
    constants = [0.0 if value is None else value for row in values for value in row]
    written = abreast(stage, inputs, [entry for row in jacobian for entry in row], learns)
    known = problem.prelude, problem.numbers, problem.parameters
    nothing = "static void prelude_adjoint(const Real*, const Real*, Real*) {}"
    return [
        "struct Problem {",
        f"static constexpr int n = {n}, m = {m}, PARAMETERS = {problem.parameters};",
        f"static constexpr int NUMBERS = {len(problem.numbers)}, STEP_ACTIVE = {len(active)};",
        f"static constexpr bool LEARNS = {literal(learns)}, ABREAST = {literal(bool(written))};",
        table("int", "step_active", active),
        table("Real", "step_constant", constants),
        plain("prelude(const Real* p, Real* y)", problem.prelude, "p", problem.numbers),
        function(
            f"{TEMPLATE} void step({POINT}, const Real* q, V* y)",
            program,
            "q",
            into("y", stage.outputs),
        ),
        bend(stage, inputs, active, learns),
        weigh_numbers(stage, learns),
        *written,
        prelude_adjoint(*known) if learns else nothing,
        "};",
    ]


class _Moments(torch.autograd.Function):
    """`moments` as a function of the numbers of the model and rows."""

    @staticmethod
    def forward(ctx: Any, ready: Ready, numbers: Tensor, *rows: Tensor) -> tuple[Tensor, Tensor]:
        device = rows[0].device
        numbers, start, covariance, controls, scale = brought(numbers, *rows)
        (count, steps, m), n = controls.shape, start.shape[-1]
        found = start.new_empty(count, steps, 2), start.new_empty(count, steps, 2, 2)
        keeps, whole = any(ctx.needs_input_grad), -(-count // LANES) * LANES
        kept = start.new_empty(whole, steps, n * (1 + n + n + m)) if keeps else None
        given = pointers(numbers, start, covariance, controls, scale, *found, kept)
        ready.library.dmmv_moments(*counts(count, torch.get_num_threads(), steps), *given)
        if kept is not None:
            ctx.library, ctx.states = ready.library, n
            ctx.save_for_backward(numbers, controls, scale, kept)
        return found[0].to(device), found[1].to(device)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        numbers, controls, scale, kept = ctx.saved_tensors
        (count, steps, _), n = controls.shape, ctx.states
        found = (
            torch.zeros_like(numbers),
            kept.new_empty(count, n),
            kept.new_empty(count, n, n),
            torch.empty_like(controls),
            torch.empty_like(scale),
        )
        given = numbers, controls, scale, kept, *brought(*slopes)
        each = counts(count, torch.get_num_threads(), steps)
        ctx.library.dmmv_moments_adjoint(*each, *pointers(*given, *found))
        return None, *(each.to(slopes[0].device) for each in found)
