"""Libraries of models that are modules: one step, with parameters and buffers as its numbers."""

import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.control.native.core_forms import decompositions
from diffstack_mmv.control.native.lowering import CannotLowerError, Lowering
from diffstack_mmv.control.native.operations import HANDLERS
from diffstack_mmv.control.native.scalar import Program
from diffstack_mmv.control.native.solver import LONG_SOURCE
from diffstack_mmv.control.native.stages import StagedStep, staged_step
from dmmv_conventions.libraries import REALS, CannotBuildError, load
from dmmv_conventions.progress import waiting

LOGGER = logging.getLogger(__name__)
Source = Callable[[StagedStep, bool, str], str]
"""(step, whether its numbers are learned, "float" or "double") -> C++."""


class Part(NamedTuple):
    """A function of a library that can be built by itself, with options of the compiler."""

    name: str
    flags: tuple[str, ...]


class TakenModule(NamedTuple):
    """A step as scalars, and the tensors of the module that it reads."""

    problem: StagedStep
    tensors: tuple[Tensor, ...]

    def is_of(self, module: nn.Module) -> bool:
        """Whether the module still has these tensors, whatever their values are by now."""
        present = floating_tensors(module)
        return len(present) == len(self.tensors) and all(
            mine is theirs for mine, theirs in zip(self.tensors, present.values(), strict=True)
        )

    def numbers(self) -> Float[Tensor, " P"]:
        """Values of the tensors in one row, with their derivatives."""
        return torch.cat([self.tensors[0].new_zeros(0), *(each.flatten() for each in self.tensors)])


def floating_tensors(module: nn.Module) -> dict[str, Tensor]:
    """Parameters and buffers by name, without whole numbers and truths."""
    every = {**dict(module.named_parameters()), **dict(module.named_buffers())}
    return {name: each for name, each in every.items() if each.is_floating_point()}


def taken(module: nn.Module, n: int, m: int, dtype: torch.dtype) -> TakenModule:
    """The step (state, control) -> next state of a module.

    Tensors that are neither parameters nor buffers count as constants.

    Raises:
        CannotLowerError: It has no scalar form.
    """
    from torch.fx.experimental.proxy_tensor import make_fx

    named = floating_tensors(module)
    if any(each.dtype != dtype for each in named.values()) or not named:
        raise CannotLowerError(f"tensors of another type than {dtype}")

    def step(state: Tensor, control: Tensor, *tensors: Tensor) -> list[Tensor]:
        own = dict(zip(named, tensors, strict=True))
        return [torch.func.functional_call(module, own, (state, control))]

    device = next(iter(named.values())).device
    inputs = [torch.zeros(1, size, dtype=dtype, device=device) for size in (n, m)]
    inputs += [each.detach() for each in named.values()]
    with torch.no_grad():
        graph = make_fx(step, decomposition_table=decompositions())(*inputs)
    program = Program()
    (following,) = Lowering(program, HANDLERS)(graph, _leaves(program, inputs))
    if following.size != n:
        raise CannotLowerError(f"{following.size} results instead of {n}")
    count = sum(each.numel() for each in named.values())
    step_taken = staged_step(program, list(following.flat), n, m, count)
    return TakenModule(step_taken, tuple(named.values()))


def _leaves(program: Program, inputs: list[Tensor]) -> list[np.ndarray]:
    count, leaves = 0, []
    for position, each in enumerate(inputs):
        entries = np.empty(each.numel(), dtype=object)
        for k in range(each.numel()):
            place = ("xu"[position], 0, k) if position < 2 else ("p", count + k)
            entries[k] = program.leaf(*place)
        count += each.numel() if position >= 2 else 0
        leaves.append(entries.reshape(each.shape))
    return leaves


class Ready(NamedTuple):
    """A library, what it is of, and the present numbers of the model."""

    library: Any
    problem: StagedStep
    numbers: Float[Tensor, " P"]


class ModelWorkshop:
    """Libraries of one model, or the knowledge that there can be none.

    Args:
        purpose: What they are for, told to people.
        parts: Functions of a library; those of a long source are built side by side.
    """

    def __init__(self, purpose: str, parts: Sequence[Part]) -> None:
        self.purpose = purpose
        self.parts = parts
        self.taken: TakenModule | None = None
        self.is_refused = False

    def library(
        self, module: nn.Module, n: int, m: int, dtype: torch.dtype, source: Source
    ) -> Ready | None:
        """The library of a step (state, control) -> next state, None where there is none.

        Args:
            module: The step.
            n: Number of states.
            m: Number of controls.
            dtype: Of all tensors.
            source: Makes the C++ from the step, whether its numbers are learned, and its type.
        """
        if self.is_refused or dtype not in REALS:
            return None
        try:
            if self.taken is None or not self.taken.is_of(module):
                self.taken = taken(module, n, m, dtype)
            numbers = self.taken.numbers()
            problem = self.taken.problem
            if (problem.state, problem.inputs, numbers.dtype) != (n, m, dtype):
                return None  # rows that this model does not take, and tensors say so
            built = self._built(problem, source, numbers.requires_grad, dtype)
        except (CannotLowerError, CannotBuildError) as failure:
            self.is_refused = True
            reason = next(iter(str(failure).strip().splitlines()), type(failure).__name__)
            LOGGER.info("No library for %s (%s)", self.purpose, reason)
            return None
        return Ready(built, problem, numbers)

    def _built(self, problem: StagedStep, source: Source, learns: bool, dtype: torch.dtype) -> Any:
        key = id(problem), source, learns, dtype
        if key not in _LIBRARIES:
            began_s = time.perf_counter()
            LOGGER.info("Compiling %s: one library", self.purpose)
            with waiting(f"compile {self.purpose}"):
                # the problem is kept, so that no other one gets its identity
                code = source(problem, learns, REALS[dtype])
                _LIBRARIES[key] = problem, _loaded(code, self.parts)
            LOGGER.info("Compiled it in %.1f s", time.perf_counter() - began_s)
        return _LIBRARIES[key][1]


def _loaded(code: str, parts: Sequence[Part]) -> Any:
    """The functions of a source, from one library or, of a long one, from one each."""
    if len(code) <= LONG_SOURCE:
        return load(code)
    with ThreadPoolExecutor(len(parts), "build") as builders:
        built = list(builders.map(lambda part: load(code, *part.flags), parts))
    each = zip(parts, built, strict=True)
    return SimpleNamespace(**{part.name: getattr(library, part.name) for part, library in each})


_LIBRARIES: dict[tuple[int, Source, bool, torch.dtype], tuple[StagedStep, Any]] = {}
