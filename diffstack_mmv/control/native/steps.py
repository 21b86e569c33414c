"""One step of a model for many rows in a call of a generated library; its results are constants."""

import weakref
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.control.native.code import function
from diffstack_mmv.control.native.generation import POINT, TEMPLATE, _into, _prelude, header
from diffstack_mmv.control.native.library import pointers
from diffstack_mmv.control.native.modules import Workshop, counts
from diffstack_mmv.control.native.stages import StagedProblem

Step = Callable[[Float[Tensor, "N n"], Float[Tensor, "N m"]], Float[Tensor, "N n"]]


def generated_step(
    owner: nn.Module, step: nn.Module, n: int, m: int, dtype: torch.dtype
) -> Step | None:
    """The step for many rows, without derivatives; None without a library.

    Args:
        owner: Model that the step is made of, and with which its library is forgotten.
        step: (state, control) -> next state, one class of them per owner; every row on its own.
        n: Number of states.
        m: Number of controls.
        dtype: Of all tensors.
    """
    workshops = _WORKSHOPS.setdefault(owner, {})
    kind = type(step)
    if kind not in workshops:
        workshops[kind] = Workshop(f"steps of {type(owner).__name__}")
    ready = workshops[kind].library(step, n, m, dtype, source)
    if ready is None:
        return None
    call, numbers = ready.library.dmmv_step, ready.numbers.detach()

    def following(state: Tensor, control: Tensor) -> Tensor:
        given = state.detach().contiguous(), control.detach().contiguous()
        found = torch.empty_like(given[0])
        call(*counts(len(state), torch.get_num_threads()), *pointers(numbers, *given, found))
        return found

    return following


_WORKSHOPS: weakref.WeakKeyDictionary[nn.Module, dict[type[nn.Module], Workshop]] = (
    weakref.WeakKeyDictionary()
)


def source(problem: StagedProblem, learns: bool, real: str) -> str:
    """A whole library; nothing in it can be learned."""
    (n, m, _, parameters), stage = problem.sizes, problem.step
    value = f"{TEMPLATE} void step({POINT}, const Real* q, V* y)"
    return "\n".join(
        [
            "#include <cmath>",
            "#include <type_traits>",
            "#include <utility>",
            f"typedef {real} Real;",
            *map(header, ("numbers", "small", "stage")),
            "using namespace dmmv;",
            "struct Problem {",
            f"static constexpr int n = {n}, m = {m}, PARAMETERS = {parameters};",
            f"static constexpr int NUMBERS = {len(problem.numbers)};",
            _prelude(problem),
            function(value, stage.program, "q", _into("y", stage.outputs)),
            "};",
            header("step"),
        ]
    )
