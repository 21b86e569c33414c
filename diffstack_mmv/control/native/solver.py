"""Solves a few problems each on its own, in one call of a library generated for their kind.

A tensor program pays for every operation, a scalar one for every number: for few problems the
second is faster by two orders of magnitude, and needs no iteration beyond its own.
"""

import ctypes
import functools
import logging
import time
from collections.abc import Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.compilation import kind, label, refusals, retain_freed_memory
from diffstack_mmv.control.iteration import Settings
from diffstack_mmv.control.native.capture import Taken, Trajectory
from diffstack_mmv.control.native.generation import Library, source
from diffstack_mmv.control.native.lowering import CannotLowerError
from diffstack_mmv.control.native.rows import BatchRecorder, forms_of, from_rows, in_rows
from diffstack_mmv.control.native.stages import StagedProblem
from diffstack_mmv.control.once import once
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.selection import Batched, is_shared
from diffstack_mmv.types import Solution, SolverStatus
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
MOST_SIZES = 64  # step sizes that a library tries
MOST_LIBRARIES = 7
"""Shapes of a kind of problem that get a library; more take too long, and outgrow the compiler's
list of 8 graphs. A planner that fills its neighbors up to 4, 8, 16, ... has 7 with up to 128."""
LONGEST_SOURCE = 800_000
"""Characters of a library without its tables, beyond which a compiler takes a minute and more.
DiffGM3 has 0.4 to 0.65 of it, whatever the number of agents, and takes up to 40 s, where kernels on
tensors take ten minutes."""
LONG_SOURCE = 100_000
"""Characters beyond which the compiler searches less, `QUICKLY`."""
QUICKLY = (
    "--param=sccvn-max-alias-queries-per-access=50",
    "--param=dse-max-alias-queries-per-store=16",
)
"""How far GCC looks for the same number in memory, which takes long in long functions. The solver
of DiffGM3 is built in four fifths of the time, its derivative in half, neither is slower by more
than 4 %. With `-fno-gcse` besides it would be two thirds, and 6 % slower; with `-O1` a third, and a
quarter slower."""
LONG_ADJOINT = 300_000
"""Characters of an adjoint, which runs once per solve, beyond which the compiler takes less effort:
that of DiffGM3 is no slower for it, and built in two thirds of the time."""


class Numbers(NamedTuple):
    """What a solver is set to."""

    settings: Settings
    max_iterations: int
    always_exact: bool  # whether the dynamics are differentiated twice at every iteration
    most: int  # problems up to which each is solved on its own


def solve(
    dynamics: Dynamics,
    cost: Cost,
    numbers: Numbers,
    state: Float[Tensor, "*b n"],
    controls: Float[Tensor, "*b T m"],
) -> Solution | None:
    """The solution with its derivatives, as that of `ILQR`; None if there is no library for it."""
    if not _is_possible(dynamics, cost, numbers, state):
        return None
    sizes = state.dtype, state.dim(), state.shape[-1], *controls.shape[-2:]
    key = kind(dynamics), kind(cost), *sizes
    workshop = _workshop(key, label(dynamics))
    if workshop.is_refused:
        return None
    return workshop.solve(dynamics, cost, numbers, state, controls)


def _is_possible(dynamics: Dynamics, cost: Cost, numbers: Numbers, state: Tensor) -> bool:
    count = state[..., 0].numel()
    fits = 0 < count <= numbers.most and within_reach(state) and state.dtype in REALS
    fits = fits and numbers.settings.sizes.numel() <= MOST_SIZES
    if count <= 1 or not fits:
        return fits
    apart = isinstance(cost, Batched) and (isinstance(dynamics, Batched) or is_shared(dynamics))
    apart = apart and state.dim() == 2
    if not apart:
        _tell_together(label(dynamics))
    return apart


@functools.cache
def _tell_together(problem: str) -> None:
    """Say once per model why a batch waits for kernels, which take minutes where it has six states.

    A library solves each problem on its own, so it has to know which tensors are whose.
    """
    LOGGER.info(
        "No library for several problems of %s (which tensors belong to which problem is not "
        "told): kernels on tensors. Give Batched(dynamics), Batched(cost, tensor, ...) and a state "
        "of shape (b, n).",
        problem,
    )


@functools.cache
def _workshop(key: Hashable, name: str) -> "SolverWorkshop":
    return SolverWorkshop(name)


class SolverWorkshop:
    """Libraries for the problems of one kind, or the knowledge that there can be none.

    Args:
        problem: What they are for, told to people.
    """

    def __init__(self, problem: str) -> None:
        self.problem = problem
        self.recorder = BatchRecorder()
        self.known: dict[Library, set[int]] = {each: set() for each in Library}
        self.is_refused = False
        self.is_full = False

    def solve(
        self,
        dynamics: Dynamics,
        cost: Cost,
        numbers: Numbers,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
    ) -> Solution | None:
        """The solution, None where there is no library."""
        try:
            at = _anywhere(state, controls)
            taken, parameters = self.recorder(dynamics, cost, at, state.dtype)
            hidden = any(each.requires_grad for each in (state, *parameters))
            if not self._has_room(taken.problem):
                return None
            self._prepare(taken.problem, state.dtype, hidden and torch.is_grad_enabled())
        except (CannotLowerError, CannotBuildError, *refusals().failed) as failure:
            self.is_refused = True
            reason = next(iter(str(failure).strip().splitlines()), type(failure).__name__)
            LOGGER.info("No library for %s (%s): kernels on tensors", self.problem, reason)
            return None
        return solved(taken, parameters, numbers, state, controls)

    def _has_room(self, problem: StagedProblem) -> bool:
        """Whether a problem has a library or may get one; those that are there stay in use."""
        known = self.known[Library.SOLVE]
        fits = id(problem) in known or len(known) < MOST_LIBRARIES
        if not fits and not self.is_full:
            self.is_full = True
            LOGGER.warning(
                "No library for %s in more than %d shapes: kernels on tensors for all others. "
                "Fill problems up to few shapes, with agents that are absent.",
                self.problem,
                MOST_LIBRARIES,
            )
        return fits

    def _prepare(self, problem: StagedProblem, dtype: torch.dtype, differentiates: bool) -> None:
        """Have the solver at hand, and its derivatives if they are asked for.

        Both before the first solution: what cannot be built backward could not be solved otherwise
        any more.
        """
        wanted = tuple(Library) if differentiates else (Library.SOLVE,)
        missing = [name for name in wanted if id(problem) not in self.known[name]]
        if not missing:
            return
        began_s = time.perf_counter()
        told = " and ".join(missing)
        LOGGER.info("Compiling the solver for %s: one library (%s)", self.problem, told)
        with waiting(f"compile the solver for {self.problem}: library"):
            for library in [_begun(problem, name, dtype) for name in missing]:
                library.result()
        LOGGER.info("Compiled it in %.1f s", time.perf_counter() - began_s)
        for name in missing:
            self.known[name].add(id(problem))


_LIBRARIES: dict[tuple[int, Library, torch.dtype], tuple[StagedProblem, Future[Any]]] = {}


def library(problem: StagedProblem, name: Library, dtype: torch.dtype) -> Any:
    """A library of a problem."""
    return _begun(problem, name, dtype).result()


def _begun(problem: StagedProblem, name: Library, dtype: torch.dtype) -> Future[Any]:
    """A library that is there, or being built."""
    key = id(problem), name, dtype
    if key not in _LIBRARIES:
        retain_freed_memory()
        code = source(problem, name, REALS[dtype])
        length = effort_of(code)
        if name == Library.SOLVE and length > LONGEST_SOURCE:
            raise CannotBuildError(f"a source of {length} characters takes too long")
        # the problem is kept, so that no other one gets its identity
        _LIBRARIES[key] = problem, _builders().submit(load, code, *_effort(name, length))
    return _LIBRARIES[key][1]


def _effort(name: Library, length: int) -> list[str]:
    """Options of the compiler for a library whose source has so many characters."""
    once = ["-O1"] if name == Library.ADJOINT and length > LONG_ADJOINT else []
    return [*once, *(QUICKLY if length > LONG_SOURCE else ())]


def effort_of(code: str) -> int:
    """Characters of a source without its tables, which are long for many agents and read fast."""
    lines = code.splitlines()
    return sum(len(line) for line in lines if not line.startswith(("static constexpr", "{")))


@functools.cache
def _builders() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(2, "build")


def _anywhere(state: Tensor, controls: Tensor) -> Trajectory:
    """Trajectories of the right shape for one problem."""
    lead = (1,) * (state.dim() - 1)
    sizes = *controls.shape[-2:], state.shape[-1]
    return _zero_trajectory(lead, *sizes, state.dtype, state.device)


@functools.lru_cache(maxsize=64)
def _zero_trajectory(
    lead: tuple[int, ...], steps: int, m: int, n: int, dtype: torch.dtype, device: torch.device
) -> Trajectory:
    shapes = ((*lead, steps + 1, size) for size in (n, m))
    return Trajectory(*(torch.zeros(shape, dtype=dtype, device=device) for shape in shapes))


def solved(
    taken: Taken,
    parameters: Sequence[Tensor],
    numbers: Numbers,
    state: Float[Tensor, "*b n"],
    controls: Float[Tensor, "*b T m"],
) -> Solution:
    """Call the library, with derivatives where they are asked for."""
    batch = state.shape[:-1]
    flat = state.reshape(-1, state.shape[-1]), controls.reshape(-1, *controls.shape[-2:])
    results = _Solve.apply(taken, numbers, *flat, *parameters)
    return Solution(*(result.reshape(batch + result.shape[1:]) for result in results))


class _Solve(torch.autograd.Function):
    """The solution as a function of parameters and initial state."""

    @staticmethod
    def forward(
        ctx: Any,
        taken: Taken,
        numbers: Numbers,
        state: Tensor,
        controls: Tensor,
        *tensors: Tensor,
    ) -> tuple[Tensor, ...]:
        problem: StagedProblem = taken.problem
        count, (n, m, steps, _) = len(state), problem.sizes
        device = state.device
        rows = in_rows(taken, tensors, count, state), numbers.settings.box, state, controls
        parameters, box, state, controls = brought(*rows)
        x, u = state.new_empty(count, steps + 1, n), state.new_empty(count, steps, m)
        cost, residual = state.new_empty(count), state.new_empty(count)
        iterations = torch.empty(count, dtype=torch.long)
        status = torch.empty_like(iterations)
        record = settings_record(state.dtype)(
            numbers.max_iterations,
            numbers.settings.sizes.numel(),
            int(not numbers.always_exact),
            float(numbers.settings.tolerance),
            float(numbers.settings.regularisation),
        )
        given = parameters, box, state, controls
        results = x, u, cost, residual, iterations, status
        call = library(problem, Library.SOLVE, state.dtype).dmmv_solve
        sizes = counts(count, torch.get_num_threads())
        call(*sizes, *pointers(*given), ctypes.byref(record), *pointers(*results))
        sizes = [one.numel() for one in taken.parameters]
        ctx.problem, ctx.forms = problem, forms_of(tensors, sizes, ctx.needs_input_grad[4:])
        returned = tuple(each.to(device) for each in results)
        # the states as they are returned have a graph
        ctx.save_for_backward(parameters, box, x, u, status, returned[0])
        ctx.mark_non_differentiable(*returned[3:])
        return returned

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        *held, status, states = ctx.saved_tensors
        parameters, x = held[0], held[2]
        with torch.no_grad():
            by_parameters, by_state = torch.empty_like(parameters), torch.empty_like(x[:, 0])
            given = *held, status == SolverStatus.CONVERGED, *brought(*slopes[:3])
            call = library(ctx.problem, Library.ADJOINT, x.dtype).dmmv_adjoint
            sizes = counts(len(x), torch.get_num_threads())
            call(*sizes, *pointers(*given, by_parameters, by_state))
            hidden = from_rows(by_parameters.to(states.device), ctx.forms)
        of_state, *hidden = once([by_state.to(states.device), *hidden], states)
        return None, None, of_state, None, *hidden


@functools.cache
def settings_record(dtype: torch.dtype) -> type[ctypes.Structure]:
    """The numbers of a solver as the library reads them, in one precision."""
    real = ctypes.c_float if dtype == torch.float32 else ctypes.c_double
    counts = [(name, ctypes.c_int) for name in ("max_iterations", "sizes", "curvature")]
    fields = [*counts, ("tolerance", real), ("regularisation", real)]
    return type("Settings", (ctypes.Structure,), {"_fields_": fields})
