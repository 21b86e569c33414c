"""Steps many rows forward in a generated library: the same function of each row, time after time.

A roll-out in tensors pays for every operation of every step; here a step of eight rows is one pass
over generated code.
"""

import functools
import logging
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.compilation import copied, kind, label, refusals
from diffstack_mmv.control.native.capture import Recorder, Taken, Trajectory
from diffstack_mmv.control.native.code import function, into
from diffstack_mmv.control.native.library import POINT, TEMPLATE, header, opening, plain
from diffstack_mmv.control.native.lowering import CannotLowerError, Entries
from diffstack_mmv.control.native.scalar import Program
from diffstack_mmv.control.native.stages import StagedStep, staged_step
from dmmv_conventions.libraries import (
    REALS,
    CannotBuildError,
    brought,
    counts,
    load,
    pointers,
    within_reach,
)
from dmmv_conventions.progress import waiting

LOGGER = logging.getLogger(__name__)

RowStep = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""(states (b, n), inputs (b, k)) -> following states (b, n), outputs (b, r); each row by itself."""


class Scanned(NamedTuple):
    """Rows at all times."""

    states: Float[Tensor, "b T1 n"]
    outputs: Float[Tensor, "b T r"]


def scan(
    step: RowStep,
    state: Float[Tensor, "b n"],
    inputs: Float[Tensor, "b T k"],
    parts: Sequence[Callable[..., Any]] = (),
) -> Scanned | None:
    """Step rows forward, without a gradient; None if there is no library for it.

    Nor is there one for states and inputs of different numbers of rows.

    Args:
        step: What becomes of a row in a step; the tensors that it hides are shared by all rows.
        state: At the start.
        inputs: Of each row in each step.
        parts: Functions that the step calls, which tell it from other steps of the same code.
    """
    if not _fit(state, inputs):
        return None
    key = kind(step), *map(kind, parts), state.dtype, state.shape[-1], inputs.shape[-1]
    return _stepper(key, label(step))(step, state.detach(), inputs.detach())


def _fit(state: Tensor, inputs: Tensor) -> bool:
    """Whether both are rows of the same number and type, which a library knows of the state."""
    plain = within_reach(state) and state.dtype in REALS and inputs.dtype == state.dtype
    alike = state.dim() == 2 and inputs.dim() == 3 and len(state) == len(inputs)
    return plain and alike and state.numel() > 0 and inputs.numel() > 0


@functools.cache
def _stepper(key: Hashable, name: str) -> "_Stepper":
    return _Stepper(name)


def advance(step: RowStep, state: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """One step of one row, of shapes (s,) and (r,)."""
    return step(state, inputs)


def _arrange(
    program: Program, results: Sequence[Entries], at: Trajectory, parameters: int
) -> StagedStep:
    n, k = at.states.shape[-1], at.controls.shape[-1]
    if results[0].size != n:
        raise CannotLowerError(f"{results[0].size} results instead of {n}")
    nodes = [node for result in results for node in result.flat]
    return staged_step(program, nodes, n, k, parameters)


class _Stepper:
    """Libraries for the steps of one kind, or the knowledge that there can be none."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.recorder = Recorder(copied(advance), _arrange)
        self.is_refused = False

    def __call__(self, step: RowStep, state: Tensor, inputs: Tensor) -> Scanned | None:
        if self.is_refused:
            return None
        try:
            taken = self.recorder(Trajectory(state[:1].clone(), inputs[:1, 0].clone()), step)
            call = library(taken.problem, state.dtype).dmmv_scan
        except (CannotLowerError, CannotBuildError, *refusals().failed) as failure:
            self.is_refused = True
            LOGGER.info("No library for the steps of %s (%s): tensors", self.name, failure)
            return None
        return _scanned(call, taken, state, inputs)


def _scanned(call: Any, taken: Taken, state: Tensor, inputs: Tensor) -> Scanned:
    problem: StagedStep = taken.problem
    count, steps, _ = inputs.shape
    rows = [each.detach().to(state).flatten() for each in taken.parameters]
    given = brought(torch.cat([state.new_empty(0), *rows]), state, inputs)
    result = Scanned(
        given[1].new_empty(count, steps + 1, problem.state),
        given[1].new_empty(count, steps, len(problem.step.outputs) - problem.state),
    )
    sizes = counts(count, torch.get_num_threads(), steps)
    call(*sizes, *pointers(*given, *result))
    return Scanned(*(each.to(state.device) for each in result))


_LIBRARIES: dict[tuple[int, torch.dtype], tuple[StagedStep, Any]] = {}


def library(problem: StagedStep, dtype: torch.dtype) -> Any:
    """The library of a step."""
    key = id(problem), dtype
    if key not in _LIBRARIES:
        with waiting("compile steps"):
            # the step is kept, so that no other one gets its identity
            _LIBRARIES[key] = problem, load(_source(problem, REALS[dtype]))
    return _LIBRARIES[key][1]


def _source(problem: StagedStep, real: str) -> str:
    outputs = problem.step.outputs
    lines = [
        "using namespace dmmv;",
        "struct Problem {",
        f"static constexpr int n = {problem.state}, inputs = {problem.inputs};",
        f"static constexpr int outputs = {len(outputs) - problem.state};",
        f"static constexpr int NUMBERS = {len(problem.numbers)};",
        plain("prelude(const Real* p, Real* y)", problem.prelude, "p", problem.numbers),
        function(
            f"{TEMPLATE} void step({POINT}, const Real* q, V* y)",
            problem.step.program,
            "q",
            into("y", outputs),
        ),
        "};",
    ]
    return "\n".join([*opening(real, "numbers"), *lines, header("scan")]) + "\n"
