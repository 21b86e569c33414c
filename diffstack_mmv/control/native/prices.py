"""Prices many plans of each problem in a generated library: the cost at each of their times.

On tensors every operation passes over plans times agents; here eight plans at a time are priced in
registers, and the backward pass is generated as well.
"""

import functools
import logging
from collections.abc import Hashable
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.compilation import kind, refusals
from diffstack_mmv.control.native.capture import Trajectory
from diffstack_mmv.control.native.code import function, into, rows_of, table
from diffstack_mmv.control.native.library import POINT, TEMPLATE, by_kind, header, opening
from diffstack_mmv.control.native.lowering import CannotLowerError
from diffstack_mmv.control.native.own_numbers import (
    cost_number_gradients,
    prelude,
    prelude_adjoint,
)
from diffstack_mmv.control.native.repetition import with_sums
from diffstack_mmv.control.native.rows import (
    BatchRecorder,
    TakenBatch,
    forms_of,
    from_rows,
    in_rows,
)
from diffstack_mmv.control.native.solver import (
    LONGEST_SOURCE,
    MOST_LIBRARIES,
    effort_of,
)
from diffstack_mmv.control.native.stages import Stage, StagedProblem
from diffstack_mmv.control.selection import Batched
from diffstack_mmv.types import on_host
from dmmv_conventions.libraries import REALS, CannotBuildError, counts, load, pointers
from dmmv_conventions.progress import waiting

LOGGER = logging.getLogger(__name__)


def prices(
    cost: Batched, states: Float[Tensor, "b C T1 n"], controls: Float[Tensor, "b C T1 m"]
) -> Float[Tensor, "b C T1"] | None:
    """Cost of plans at each time, None if there is no library for it.

    Can be differentiated once by the tensors of the cost and by those that it hides; plans are
    constants.

    Args:
        cost: Of states `b T1 n` and controls `b T1 m`: of one plan of each problem.
        states: Of the plans.
        controls: Of the plans.
    """
    found = pricer(cost, states, controls)
    return None if found is None else found(states, controls)


class Pricer(NamedTuple):
    """Prices any number of plans of the same problems."""

    library: Any
    batch: TakenBatch
    dtype: torch.dtype
    problems: int

    def __call__(
        self, states: Float[Tensor, "b C T1 n"], controls: Float[Tensor, "b C T1 m"]
    ) -> Float[Tensor, "b C T1"] | None:
        """Cost of plans at each time, see `prices`.

        None if it had to carry a gradient to them, and for plans of other sizes or types.
        """
        if states.requires_grad or controls.requires_grad or not self._fit(states, controls):
            return None
        plans = states.detach().contiguous(), controls.detach().contiguous()
        given = self.library, self.batch, *plans, *self.batch.parameters
        priced: Tensor = _Prices.apply(*given)  # type: ignore[no-untyped-call]
        return priced

    def _fit(self, states: Tensor, controls: Tensor) -> bool:
        """Whether these are plans as the library knows them: it reads so many numbers of each."""
        n, m, steps, _ = self.batch.taken.problem.sizes
        plans = self.problems, states.shape[1], steps + 1
        fits = states.shape == (*plans, n) and controls.shape == (*plans, m)
        return fits and states.dtype == controls.dtype == self.dtype and on_host(states, controls)


def pricer(
    cost: Batched, states: Float[Tensor, "b C T1 n"], controls: Float[Tensor, "b C T1 m"]
) -> Pricer | None:
    """Prices plans of as many times as these, None if there is no library for it; see `prices`."""
    plain = on_host(states) and states.dtype in REALS and controls.dtype == states.dtype
    alike = states.dim() == 4 and controls.shape[:-1] == states.shape[:-1]
    alike = alike and all(len(each) in (1, len(states)) for each in cost.tensors)
    if not (plain and alike and states.numel() and controls.numel()):
        return None
    key = kind(cost), states.dtype, states.shape[2:], controls.shape[-1]
    return _workshop(key)(cost, states, controls)


@functools.cache
def _workshop(key: Hashable) -> "_Workshop":
    return _Workshop()


class _Workshop:
    """Libraries for the costs of one kind, or the knowledge that there can be none."""

    def __init__(self) -> None:
        self.recorder = BatchRecorder()
        self.built: dict[int, tuple[StagedProblem, Any | None]] = {}
        self.is_refused = False

    def __call__(self, cost: Batched, states: Tensor, controls: Tensor) -> Pricer | None:
        if self.is_refused:
            return None
        try:
            # not like a slice of them, whose strides tell the number of plans: one more shape
            one = Trajectory(*(each.new_zeros(1, *each.shape[2:]) for each in (states, controls)))
            taken = self.recorder(_first_state, cost, one, states.dtype)
            library = self._library(taken.taken.problem, states.dtype)
        except (CannotLowerError, CannotBuildError, *refusals().failed) as failure:
            self.is_refused = True
            LOGGER.info("No library for the costs of candidates (%s): tensors", failure)
            return None
        return None if library is None else Pricer(library, taken, states.dtype, len(states))

    def _library(self, problem: StagedProblem, dtype: torch.dtype) -> Any | None:
        """The library of a shape, None where it would take too long to build; others may not."""
        if id(problem) not in self.built:
            code, library = source(problem, REALS[dtype]), None
            if sum(each is not None for _, each in self.built.values()) >= MOST_LIBRARIES:
                LOGGER.info("Costs of candidates in more than %d shapes: tensors", MOST_LIBRARIES)
            elif effort_of(code) > LONGEST_SOURCE:
                LOGGER.info("A source of %d characters takes too long: tensors", effort_of(code))
            else:
                with waiting("compile the costs of candidates"):
                    library = load(code)
            # the problem is kept, so that no other one gets its identity
            self.built[id(problem)] = problem, library
        return self.built[id(problem)][1]


def _first_state(state: Tensor, control: Tensor) -> Tensor:
    """In the place of dynamics, which costs do without."""
    return state.clone()


def source(problem: StagedProblem, real: str) -> str:
    """A whole library.

    Args:
        problem: Its costs.
        real: "float" or "double".
    """
    n, m, steps, parameters = problem.sizes
    widest = max(len(numbers) for numbers in problem.cost_numbers)
    known = problem.parameters, problem.numbers, parameters
    lines = [
        *opening(real, "numbers", "small"),
        "using namespace dmmv;",
        "struct Problem {",
        f"static constexpr int n = {n}, m = {m}, T = {steps}, PARAMETERS = {parameters};",
        f"static constexpr int NUMBERS = {len(problem.numbers)}, COST_NUMBERS = {widest};",
        table("int", "cost_kind", problem.kinds),
        rows_of("cost_numbers", problem.cost_numbers, widest),
        prelude(problem),
        *(_value(number, cost) for number, cost in enumerate(problem.costs)),
        by_kind("cost", "cost_{}", len(problem.costs)),
        *cost_number_gradients(problem.costs),
        prelude_adjoint(*known),
        "};",
        header("prices"),
    ]
    return "\n".join(lines) + "\n"


def _value(number: int, cost: Stage) -> str:
    signature = f"{TEMPLATE} void cost_{number}({POINT}, const Real* q, V* y)"
    whole = function(signature, cost.program, "q", into("y", cost.outputs))
    return with_sums(whole, cost, cost.repeated.term.outputs if cost.repeated else ())


def _sizes(states: Tensor) -> list[Any]:
    """Numbers of problems, threads and plans."""
    return counts(len(states), torch.get_num_threads(), states.shape[1])


class _Prices(torch.autograd.Function):
    """`prices` as a function of the parameters of the costs."""

    @staticmethod
    def forward(
        ctx: Any,
        library: Any,
        batch: TakenBatch,
        states: Tensor,
        controls: Tensor,
        *tensors: Tensor,
    ) -> Tensor:
        parameters = in_rows(batch.taken, tensors, len(states), states)
        costs = states.new_empty(states.shape[:3])
        library.dmmv_prices(*_sizes(states), *pointers(parameters, states, controls, costs))
        sizes = [one.numel() for one in batch.taken.parameters]
        ctx.library, ctx.forms = library, forms_of(tensors, sizes, ctx.needs_input_grad[4:])
        ctx.save_for_backward(parameters, states, controls)
        return costs

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        parameters, states, controls = ctx.saved_tensors
        by_parameters = torch.empty_like(parameters)
        given = parameters, states, controls, slope.contiguous(), by_parameters
        ctx.library.dmmv_prices_adjoint(*_sizes(states), *pointers(*given))
        return None, None, None, None, *from_rows(by_parameters, ctx.forms)
