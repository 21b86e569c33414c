"""Takes down one step of a model that is a module, with its parameters and buffers as inputs."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.control.native.lowering import CannotLowerError, Lowering
from diffstack_mmv.control.native.operations import HANDLERS
from diffstack_mmv.control.native.scalar import Program
from diffstack_mmv.control.native.stages import Sizes, StagedProblem, staged


class TakenModule(NamedTuple):
    """A step as scalars, and the tensors of the module that it reads."""

    problem: StagedProblem  # without costs
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
    from torch._decomp import core_aten_decompositions
    from torch.fx.experimental.proxy_tensor import make_fx

    named = floating_tensors(module)
    if any(each.dtype != dtype for each in named.values()) or not named:
        raise CannotLowerError(f"tensors of another type than {dtype}")

    def step(state: Tensor, control: Tensor, *tensors: Tensor) -> list[Tensor]:
        own = dict(zip(named, tensors, strict=True))
        return [torch.func.functional_call(module, own, (state, control))]

    inputs = [torch.zeros(1, size, dtype=dtype) for size in (n, m)]
    inputs += [each.detach() for each in named.values()]
    with torch.no_grad():
        graph = make_fx(step, decomposition_table=core_aten_decompositions())(*inputs)
    program = Program()
    (following,) = Lowering(program, HANDLERS)(graph, _leaves(program, inputs))
    if following.size != n:
        raise CannotLowerError(f"{following.size} results instead of {n}")
    sizes = Sizes(n, m, 1, sum(each.numel() for each in named.values()))
    return TakenModule(staged(program, list(following.flat), [], sizes), tuple(named.values()))


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
