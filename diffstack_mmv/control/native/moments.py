"""Gaussian controls through a model to the moments of its positions, in a generated library.

What torch does step by step on tensors of a few entries, with the second derivatives of the model
in the backward pass, is one call here: a row at a time, eight directions of differentiation at
once.
"""

import ctypes
import logging
import time
import weakref
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.control.native.bending import bend, weigh_numbers
from diffstack_mmv.control.native.code import function, literal
from diffstack_mmv.control.native.derivative import gradient
from diffstack_mmv.control.native.generation import (
    POINT,
    TEMPLATE,
    _into,
    _prelude,
    _prelude_adjoint,
    _table,
    header,
)
from diffstack_mmv.control.native.library import REALS, CannotBuildError, load, pointers
from diffstack_mmv.control.native.lowering import CannotLowerError
from diffstack_mmv.control.native.modules import TakenModule, taken
from diffstack_mmv.control.native.stages import StagedProblem
from dmmv_conventions.progress import waiting

LOGGER = logging.getLogger(__name__)
Moments = tuple[Float[Tensor, "N T 2"], Float[Tensor, "N T 2 2"]]


def moments(
    dynamics: nn.Module,
    start: Float[Tensor, "N n"],
    covariance: Float[Tensor, "N n n"],
    controls: Float[Tensor, "N T m"],
    scale: Float[Tensor, "N T m m"],
) -> Moments | None:
    """Mean and covariance of the first two states at the times 1 .. T; None without a library.

    The mean is the roll-out of the mean controls, the covariance follows it to first order: Σ⁺ = A
    Σ Aᵀ + B L (B L)ᵀ. Can be differentiated once; a second derivative is refused.

    Args:
        dynamics: One step, (state, control) -> next state; every row on its own.
        start: Mean of the first state.
        covariance: Of the first state, symmetric.
        controls: Mean controls.
        scale: Cholesky factors L of their covariances.
    """
    if start.device.type != "cpu" or start.dtype not in REALS or controls.numel() == 0:
        return None
    workshop = _WORKSHOPS.get(dynamics)
    if workshop is None:
        workshop = _WORKSHOPS[dynamics] = Workshop(type(dynamics).__name__)
    return workshop(dynamics, start, covariance, controls, scale)


class Workshop:
    """The library of one model, or the knowledge that there can be none.

    Args:
        name: Of the model, told to people.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.taken: TakenModule | None = None
        self.is_refused = False

    def __call__(self, dynamics: nn.Module, start: Tensor, *rest: Tensor) -> Moments | None:
        """The moments, None where there is no library."""
        if self.is_refused:
            return None
        try:
            own = self._taken(dynamics, start, rest[1].shape[-1])
            numbers = own.numbers()
            built = self._library(own.problem, numbers.requires_grad, start.dtype)
        except (CannotLowerError, CannotBuildError) as failure:
            self.is_refused = True
            reason = next(iter(str(failure).strip().splitlines()), type(failure).__name__)
            LOGGER.info("No library for the decoder of %s (%s)", self.name, reason)
            return None
        flat = (each.contiguous() for each in (start, *rest))
        found: Moments = _Moments.apply(built, own.problem.sizes, numbers, *flat)  # type: ignore[no-untyped-call]
        return found

    def _taken(self, dynamics: nn.Module, start: Tensor, m: int) -> TakenModule:
        if self.taken is None or not self.taken.is_of(dynamics):
            self.taken = taken(dynamics, start.shape[-1], m, start.dtype)
        return self.taken

    def _library(self, problem: StagedProblem, learns: bool, dtype: torch.dtype) -> Any:
        key = id(problem), learns, dtype
        if key not in _LIBRARIES:
            began_s = time.perf_counter()
            LOGGER.info("Compiling the decoder for %s", self.name)
            with waiting(f"compile the decoder for {self.name}"):
                # the problem is kept, so that no other one gets its identity
                _LIBRARIES[key] = problem, load(source(problem, learns, REALS[dtype]))
            LOGGER.info("Compiled it in %.1f s", time.perf_counter() - began_s)
        return _LIBRARIES[key][1]


_WORKSHOPS: weakref.WeakKeyDictionary[nn.Module, Workshop] = weakref.WeakKeyDictionary()
_LIBRARIES: dict[tuple[int, bool, torch.dtype], tuple[StagedProblem, Any]] = {}


def source(problem: StagedProblem, learns: bool, real: str) -> str:
    """A whole library.

    Args:
        problem: A step without costs.
        learns: Whether the parameters have a gradient.
        real: "float" or "double".
    """
    fixed, entry = header("moments").split("#pragma GCC visibility push(default)")
    return "\n".join(
        [
            "#include <cmath>",
            "#include <type_traits>",
            "#include <utility>",
            f"typedef {real} Real;",
            *map(header, ("numbers", "small", "stage")),
            fixed,
            "using namespace dmmv;",
            *_problem(problem, learns),
            "#pragma GCC visibility push(default)",
            entry,
        ]
    )


def _problem(problem: StagedProblem, learns: bool) -> list[str]:
    (n, m, _, parameters), stage = problem.sizes, problem.step
    program, one = stage.program, stage.program.constant(1.0)
    inputs = [program.leaf("x", i) for i in range(n)] + [program.leaf("u", j) for j in range(m)]
    jacobian = [gradient(program, {output: one}, inputs) for output in stage.outputs]
    values = [[program.value(entry) for entry in row] for row in jacobian]
    active = [column for column in range(n + m) if any(row[column] is None for row in values)]
    constants = [0.0 if value is None else value for row in values for value in row]
    nothing = "static void prelude_adjoint(const Real*, const Real*, Real*) {}"
    return [
        "struct Problem {",
        f"static constexpr int n = {n}, m = {m}, PARAMETERS = {parameters};",
        f"static constexpr int NUMBERS = {len(problem.numbers)}, STEP_ACTIVE = {len(active)};",
        f"static constexpr bool LEARNS = {literal(learns)};",
        _table("int", "step_active", active),
        _table("Real", "step_constant", constants),
        _prelude(problem),
        function(
            f"{TEMPLATE} void step({POINT}, const Real* q, V* y)",
            program,
            "q",
            _into("y", stage.outputs),
        ),
        bend(stage, inputs, active, learns),
        weigh_numbers(stage, learns),
        _prelude_adjoint(problem) if learns else nothing,
        "};",
    ]


class _Moments(torch.autograd.Function):
    """`moments` as a function of parameters and rows."""

    @staticmethod
    def forward(
        ctx: Any, library: Any, sizes: Any, parameters: Tensor, *rows: Tensor
    ) -> tuple[Tensor, Tensor]:
        start, _, controls, scale = rows
        (count, steps, _), n, m = controls.shape, sizes.n, sizes.m
        found = start.new_empty(count, steps, 2), start.new_empty(count, steps, 2, 2)
        keeps = any(ctx.needs_input_grad)
        kept = start.new_empty(count, steps, n * (1 + n + n + m) if keeps else 0)
        given = [each.detach() for each in (parameters, *rows)]
        places = pointers(*given, *found)
        library.dmmv_moments(
            *_counts(count, steps), *places, *(pointers(kept) if keeps else [None])
        )
        ctx.library, ctx.states = library, n
        if keeps:
            ctx.save_for_backward(parameters, controls, scale, kept)
        return found

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        parameters, controls, scale, kept = ctx.saved_tensors
        (count, steps, _), n = controls.shape, ctx.states
        by_start, by_covariance = kept.new_empty(count, n), kept.new_empty(count, n, n)
        found = torch.zeros_like(parameters), by_start, by_covariance
        found = *found, torch.empty_like(controls), torch.empty_like(scale)
        given = parameters.detach(), controls, scale, kept, *(each.contiguous() for each in slopes)
        ctx.library.dmmv_moments_adjoint(*_counts(count, steps), *pointers(*given, *found))
        learns = ctx.needs_input_grad[2]
        return None, None, found[0] if learns else None, *found[1:]


def _counts(rows: int, steps: int) -> tuple[Any, Any, Any]:
    """Numbers of rows, threads and steps."""
    return ctypes.c_long(rows), ctypes.c_long(torch.get_num_threads()), ctypes.c_long(steps)
