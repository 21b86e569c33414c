"""Takes down a problem as tensor operations, with the tensors that its callables hide as inputs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.native.core_forms import decompositions
from diffstack_mmv.control.native.lowering import CannotLowerError, Entries, Lowering
from diffstack_mmv.control.native.operations import HANDLERS
from diffstack_mmv.control.native.scalar import Program
from diffstack_mmv.control.native.stages import Sizes, StagedProblem, staged
from diffstack_mmv.control.optimizer import Cost, Dynamics


def evaluate(
    dynamics: Dynamics,
    cost: Cost,
    states: Float[Tensor, "*b T+1 n"],
    controls: Float[Tensor, "*b T m"],
) -> tuple[Float[Tensor, "*b n"], Tensor]:
    """The state after the first one, and the cost of all times: all that a problem is."""
    return dynamics(states[..., 0, :], controls[..., 0, :]), cost(states, controls)


class Trajectory(NamedTuple):
    """Where a problem is taken down; only the shapes matter."""

    states: Tensor
    controls: Tensor


Arrange = Callable[[Program, Sequence[Entries], Trajectory, int], Any]
"""(program, entries of the results, where it was taken down, number of parameters) -> stages."""


def problem_stages(
    program: Program, results: Sequence[Entries], at: Trajectory, parameters: int
) -> StagedProblem:
    """The results of `evaluate` as stages.

    Raises:
        CannotLowerError: There are not as many as a problem has.
    """
    following, costs = results
    (rows, n), m = at.states.shape[-2:], at.controls.shape[-1]
    shapes = (following.size, costs.size)
    if shapes != (n, rows):
        raise CannotLowerError(f"{shapes} results instead of {(n, rows)}")
    sizes = Sizes(n, m, rows - 1, parameters)
    return staged(program, list(following.flat), list(costs.flat), sizes)


class Captured:
    """A problem as a graph, and as stages once it has been called."""

    def __init__(self, graph: torch.fx.GraphModule, arrange: Arrange) -> None:
        self.graph = graph
        self.arrange = arrange
        self.places: list[int | None] = []  # of states and controls among the inputs
        self.problem: Any = None
        self.outputs: tuple[Tensor, ...] = ()

    def take(self, inputs: Sequence[Tensor], at: Trajectory) -> Any:
        """The stages, from the graph at the first call."""
        if self.problem is None:
            found = {id(each): position for position, each in enumerate(inputs)}
            self.places = [found.get(id(wanted)) for wanted in at]
            self.problem = self._arranged(inputs, at)
        return self.problem

    def parameters(self, inputs: Sequence[Tensor]) -> list[Tensor]:
        """What the callables hide, in the order of the leaves ("p", k)."""
        return [each for i, each in enumerate(inputs) if i not in self.places]

    def _arranged(self, inputs: Sequence[Tensor], at: Trajectory) -> Any:
        from torch.fx.experimental.proxy_tensor import make_fx

        with torch.no_grad():
            core = make_fx(self.graph.forward, decomposition_table=decompositions())(*inputs)
            self.outputs = tuple(self.graph(*inputs))
        program = Program()
        lowering = Lowering(program, HANDLERS)
        results = lowering(core, self._leaves(lowering, inputs))
        count = sum(each.numel() for each in self.parameters(inputs))
        return self.arrange(program, results, at, count)

    def _leaves(self, lowering: Lowering, inputs: Sequence[Tensor]) -> list[np.ndarray]:
        program, leaves, count = lowering.program, [], 0
        for position, each in enumerate(inputs):
            if position in self.places:
                kind = "xu"[self.places.index(position)]
                leaves.append(_trajectory(program, kind, each))
            else:
                numbers = (program.leaf("p", count + k) for k in range(each.numel()))
                entries = np.fromiter(numbers, dtype=object).reshape(each.shape)
                leaves.append(_typed(lowering, entries, each.dtype))
                count += each.numel()
        return leaves


def _trajectory(program: Program, kind: str, like: Tensor) -> np.ndarray:
    entries = np.empty(like.shape, dtype=object)
    for index in np.ndindex(*like.shape):
        entries[index] = program.leaf(kind, index[-2], index[-1])
    return entries


def _typed(lowering: Lowering, entries: np.ndarray, dtype: torch.dtype) -> np.ndarray:
    if dtype.is_floating_point:
        return entries
    if dtype != torch.bool:
        raise CannotLowerError(f"a tensor of {dtype}")
    return lowering.truths(entries)


class Taken(NamedTuple):
    """A problem with the numbers of one call."""

    captured: Captured
    problem: Any  # its stages
    parameters: list[Tensor]


class Recorder:
    """Takes down problems of one kind; new closures of the same code reuse what is known.

    Args:
        function: `evaluate`, or a copy of it with a cache of its own.
        arrange: What becomes of its results.
    """

    def __init__(
        self, function: Callable[..., Any] = evaluate, arrange: Arrange = problem_stages
    ) -> None:
        self._arrange = arrange
        self._at = Trajectory(torch.empty(0), torch.empty(0))
        self._taken: Taken | None = None
        self._call = torch.compile(function, backend=self._backend, fullgraph=True, dynamic=False)

    def __call__(self, at: Trajectory, *callables: Callable[..., Any]) -> Taken:
        """The stages of a problem, and its parameters.

        Args:
            at: Where it is taken down.
            callables: What the function is called with before states and controls.

        Raises:
            CannotLowerError: It has no scalar form.
        """
        self._at, self._taken = at, None
        with torch.no_grad():
            self._call(*callables, *at)
        if self._taken is None:
            raise CannotLowerError("a problem without operations")
        return self._taken

    def _backend(self, graph: torch.fx.GraphModule, _: Sequence[Any]) -> Callable[..., Any]:
        captured = Captured(graph, self._arrange)

        def take(*inputs: Tensor) -> tuple[Tensor, ...]:
            problem = captured.take(inputs, self._at)
            self._taken = Taken(captured, problem, captured.parameters(inputs))
            return captured.outputs

        return take
