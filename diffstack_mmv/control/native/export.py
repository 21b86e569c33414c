"""A solver as a shared library with a C header, for programs without Python."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.control.compilation import copied
from diffstack_mmv.control.ilqr import ILQR, check_problem
from diffstack_mmv.control.native.capture import Recorder, Taken, Trajectory, evaluate
from diffstack_mmv.control.native.code import literal
from diffstack_mmv.control.native.generation import Library, source
from diffstack_mmv.control.native.library import header
from diffstack_mmv.control.native.solver import MOST_SIZES
from diffstack_mmv.control.optimizer import Dynamics
from diffstack_mmv.control.selection import Batched
from diffstack_mmv.types import Bounds, SolverStatus
from dmmv_conventions.disk import replacing
from dmmv_conventions.libraries import REALS, build

FILES = ("libplanner.so", "planner.h", "planner.cpp")


class ExportedTensor(NamedTuple):
    """A tensor among the parameters of a library."""

    name: str
    offset: int
    shape: tuple[int, ...]


class Exported(NamedTuple):
    """What was written."""

    library: Path
    header: Path
    source: Path
    entries: tuple[ExportedTensor, ...]


@dataclass(frozen=True)
class Export:
    """Writes libplanner.so, planner.h and planner.cpp.

    Args:
        solver: Tolerance, limit of iterations and so on, fixed in the library.
        machine: Processor as the C++ compiler calls it; "native" is this one.

    Raises:
        ValueError: The solver has more step sizes than a library tries.
    """

    solver: ILQR
    machine: str = "native"

    def __post_init__(self) -> None:
        # a library has room for so many, and does not look
        most, tried = MOST_SIZES, self.solver.line_search_steps
        require(tried <= most, "solver.line_search_steps", f"be at most {most} to export", tried)

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Batched,
        names: Mapping[str, Tensor],
        bounds: Bounds,
        state: Float[Tensor, "1 n"],
        controls: Float[Tensor, "1 T m"],
        folder: Path,
    ) -> Exported:
        """Export the solver of one kind of problem.

        Args:
            dynamics: One step.
            cost: Its tensors, one entry each.
            names: Tensors by name. All that dynamics and cost depend on become parameters of the
                library, with these names; their values are the defaults.
            bounds: Box of the controls, fixed in the library.
            state: For the precision and number of states.
            controls: For the number of steps and controls.
            folder: Where the files go.

        Returns:
            The files, and the entries of the parameters.

        Raises:
            ValueError: The arguments do not fit together.
            CannotLowerError: The callables have an operation that has no scalar form.
            CannotBuildError: There is no compiler.
        """
        check_problem(bounds, state, controls)
        require(len(state) == 1, "state", "be of one problem", len(state))
        taken = _taken(dynamics, cost, state, controls)
        known = {id(tensor): name for name, tensor in names.items()}
        entries = _entries(taken.parameters, known)
        folder.mkdir(parents=True, exist_ok=True)
        library, declared_in, generated = (folder / name for name in FILES)
        written = Exported(library, declared_in, generated, entries)
        real = REALS[state.dtype]
        declared = _declarations(taken, entries, real)
        code = source(taken.problem, Library.SOLVE, real)
        fixed = _fixed(self.solver, bounds, taken.parameters, state)
        body = "\n".join([code, declared, fixed, header("exported")]) + "\n"
        # an earlier library has other parameters than those that are declared from here on
        library.unlink(missing_ok=True)
        for file, text in ((generated, body), (declared_in, _guarded(declared))):
            with replacing(file) as unfinished:
                unfinished.write_text(text)
        build(body, library, self.machine)
        return written


def _taken(dynamics: Dynamics, cost: Batched, state: Tensor, controls: Tensor) -> Taken:
    (_, steps, m), n = controls.shape, state.shape[-1]
    at = Trajectory(state.new_zeros(1, steps + 1, n), state.new_zeros(1, steps + 1, m))
    record = Recorder(copied(evaluate))
    return record(at, dynamics, cost)


def _entries(parameters: Sequence[Tensor], known: dict[int, str]) -> tuple[ExportedTensor, ...]:
    entries, offset = [], 0
    for number, tensor in enumerate(parameters):
        name = known.get(id(tensor), f"other_{number}")
        shape = tuple(tensor.shape)
        entries.append(ExportedTensor(re.sub(r"\W+", "_", name).strip("_"), offset, shape))
        offset += tensor.numel()
    return tuple(entries)


def _declarations(taken: Taken, entries: Sequence[ExportedTensor], real: str) -> str:
    n, m, steps, parameters = taken.problem.sizes
    offsets = "\n".join(
        f"#define DMMV_AT_{name.upper()} {offset} /* {math.prod(shape)}: {shape} */"
        for name, offset, shape in entries
    )
    told = "\n".join(f"#define DMMV_{each.name} {int(each)}" for each in SolverStatus)
    return f"""
typedef {real} dmmv_real;
#define DMMV_STATES {n}
#define DMMV_CONTROLS {m}
#define DMMV_STEPS {steps}
#define DMMV_PARAMETERS {parameters}

/* where the parameters stand in their array */
{offsets}

/* what dmmv_plan returns */
{told}

struct dmmv_plan_result {{
  dmmv_real states[DMMV_STEPS + 1][DMMV_STATES];
  dmmv_real controls[DMMV_STEPS][DMMV_CONTROLS];
  dmmv_real cost, residual;
  int iterations;
}};
#ifndef __cplusplus
typedef struct dmmv_plan_result dmmv_plan_result;
#endif
"""


def _guarded(declared: str) -> str:
    return f"""/* Generated: a planner as a library. Angles in rad, all else in SI units. */
#ifndef DMMV_PLANNER_H
#define DMMV_PLANNER_H
#ifdef __cplusplus
extern "C" {{
#endif
{declared}
/* values of all parameters at the time of the export, DMMV_PARAMETERS numbers */
const dmmv_real *dmmv_defaults(void);

/* Plans from a state and a guess of the controls (DMMV_STEPS x DMMV_CONTROLS).
   Any number of threads may call it at once. */
int dmmv_plan(const dmmv_real *parameters, const dmmv_real *state, const dmmv_real *guess,
              dmmv_plan_result *result);

#ifdef __cplusplus
}}
#endif
#endif
"""


def _fixed(solver: ILQR, bounds: Bounds, parameters: Sequence[Tensor], state: Tensor) -> str:
    """Numbers that the library is built with."""

    def table(tensors: Sequence[Tensor]) -> str:
        values = (value for each in tensors for value in each.detach().to(state).flatten().tolist())
        return ", ".join(map(literal, values)) or "0"

    n = state.shape[-1]
    numbers = solver.max_iterations, solver.line_search_steps, int(not solver.curvature.is_exact(n))
    relative = solver.tolerance, solver.regularisation
    settings = ", ".join([*map(str, numbers), *map(literal, relative)])
    return f"""struct Exported {{
static constexpr Real defaults[] = {{{table(parameters)}}};
static constexpr Real bounds[] = {{{table([bounds.lower, bounds.upper])}}};
static constexpr dmmv::Settings settings = {{{settings}}};
}};"""
