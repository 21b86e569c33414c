"""Compiles the kernels of the solver, and runs them eagerly where that is not possible."""

import functools
import logging
import time
import types
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.curvature import CurvatureForm, LocalModel
from diffstack_mmv.control.iteration import Iterate, attempt
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.riccati import Policy, Stationary, box_policy, solve_free
from diffstack_mmv.control.selection import Batched, is_shared, kind
from diffstack_mmv.control.shape_polymorphic import ShapePolymorphic
from dmmv_conventions.progress import waiting

LOGGER = logging.getLogger(__name__)
LARGEST_ROW = 8  # a size beyond it may be a batch or a horizon, not a row of controls or step sizes
RETAINED = 31 << 20
"""Bytes; the C library retains freed blocks up to the largest mapped one freed so far, 32 MiB."""


class Refusals(NamedTuple):
    """Exceptions by which the compiler refuses a function."""

    too_many_graphs: type[Exception]
    failed: tuple[type[Exception], ...]


@functools.cache
def refusals() -> Refusals:
    """The exceptions of the installed compiler."""
    # imported here as everywhere in this file: the compiler takes twice as long to import as torch
    from torch._dynamo.exc import FailOnRecompileLimitHit, TorchDynamoException
    from torch._inductor.exc import InductorError

    return Refusals(FailOnRecompileLimitHit, (TorchDynamoException, InductorError))


def label(function: Any) -> str:
    """Name of a callable for people: of the module it belongs to, where there is one."""
    if isinstance(function, functools.partial):
        return label(function.func)
    if isinstance(function, Batched):
        return label(function.function)
    owner = getattr(function, "__self__", function)
    owner = getattr(owner, "dynamics", owner)  # of coordinates: the model
    return getattr(owner, "__qualname__", type(owner).__name__)


class Kernel:
    """A function of module level that runs compiled, or eagerly after the first failure to compile.

    It works on a copy of the code object, because the compiler keeps its graphs, and the short list
    of checks that select one, per code object. New closures of the same code reuse the graph: their
    tensors are inputs of it.

    Args:
        function: What to compile.
        options: Options of the compiler.
        context: What it is traced in.
        varying: Whether batch and horizon vary; otherwise every shape has a graph.
        problem: What the kernel is for, told before it is compiled.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        options: dict[str, Any],
        context: Callable[[], AbstractContextManager[Any]] = nullcontext,
        varying: bool = True,
        problem: str = "problems of any kind",
    ) -> None:
        self.function = function
        self.problem = problem
        self.compiled: Callable[..., Any] | None = None
        self.options = options
        self.context = context
        self.varying = varying

    def __call__(self, *arguments: Any) -> Any:
        """Run compiled, or eagerly where the compiler failed before."""
        if self.compiled is None:
            return self._first_call(arguments)
        try:
            with self.context():
                return self.compiled(*arguments)
        except refusals().too_many_graphs:
            # many shapes in one process: begin with an empty list of graphs
            self.compiled = None
            return self(*arguments)
        except refusals().failed as failure:
            reason = next(iter(str(failure).strip().splitlines()), type(failure).__name__)
            LOGGER.warning(
                "`%s` could not be compiled (%s) and runs eagerly. "
                "Install a C++ compiler, or set `compile=False`.",
                self.function.__name__,
                reason,
            )
            self.compiled = self.function
            return self.function(*arguments)

    def _first_call(self, arguments: tuple[Any, ...]) -> Any:
        """Compile and run, and say so: it takes seconds, or the better part of a minute."""
        if self.varying:
            _mark_varying(arguments)
        name = self.function.__name__
        LOGGER.info("Compiling the solver for %s: %s", self.problem, name)
        began_s = time.perf_counter()
        self.compiled = torch.compile(copied(self.function), fullgraph=True, options=self.options)
        with waiting(f"compile the solver for {self.problem}: {name}"):
            result = self(*arguments)
        if self.compiled is not self.function:
            LOGGER.info("Compiled %s in %.1f s", name, time.perf_counter() - began_s)
        return result


def can_compile() -> bool:
    """Whether there is a compiler for kernels on a CPU."""
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.exc import InvalidCxxCompiler

    try:
        get_cpp_compiler()
    except InvalidCxxCompiler:
        return False
    return True


class Kernels(NamedTuple):
    """The parts of an iteration and of the adjoint, eager or compiled."""

    expand: LocalModel
    box_policy: Callable[..., Policy]
    attempt: Callable[..., Iterate]
    solve_free: Callable[..., Stationary]


def eager_kernels(curvature: CurvatureForm) -> Kernels:
    """The functions as they are."""

    def as_it_is(function: Callable[..., Any], fixed_shapes: bool = False) -> Callable[..., Any]:
        return function

    return Kernels(curvature.local_model(False, as_it_is), box_policy, attempt, solve_free)


@functools.cache
def _recursions(n: int, m: int, single: bool, device: str) -> tuple[Kernel, Kernel]:
    """The kernels that depend on no callable, shared by all problems of one size.

    A batch of one has a graph of its own in any case; in a kernel of its own no call has to pass
    the checks of two.
    """
    options = _options(device)
    if device == "cpu":
        retain_freed_memory()
    return Kernel(box_policy, options), Kernel(solve_free, options)


@functools.cache
def _kernel(
    key: Hashable,
    function: Callable[..., Any],
    longest_row: int,
    device: str,
    fixed_shapes: bool,
    fixed_numbers: bool,
    problem: str,
) -> Kernel:
    """The kernel of a function for one kind of dynamics and cost."""
    if fixed_shapes:
        return Kernel(function, _options(device), varying=False, problem=problem)
    opened = with_fixed_numbers if fixed_numbers else ShapePolymorphic
    context = functools.partial(opened, longest_row)
    return Kernel(function, _options(device), context, problem=problem)


@contextmanager
def with_fixed_numbers(longest_row: int) -> Iterator[None]:
    """`ShapePolymorphic` in which a number that is no tensor belongs to the graph.

    One that has changed once is an input of it else, and of single precision inside of a loop.
    """
    from torch._dynamo import config

    with ShapePolymorphic(longest_row), config.patch(specialize_float=True):
        yield


def compiled_kernels(
    curvature: CurvatureForm,
    dynamics: Dynamics,
    cost: Cost,
    static: tuple[int, int, bool, int, int],
    state: Float[Tensor, "*b n"],
) -> Kernels:
    """Kernels for problems of this kind, compiled at their first use.

    Args:
        curvature: How the iterations come by the curvature of the dynamics.
        dynamics: The step.
        cost: The cost.
        static: Numbers a kernel is compiled for: n, m, whether the batch is one problem, leading
            dimensions, step sizes.
        state: For its device and precision.
    """
    device, is_double = state.device.type, state.dtype == torch.float64
    policy, free = _recursions(*static[:3], device)
    key = kind(dynamics), kind(cost), static, is_double
    longest = max(*static[:2], LARGEST_ROW)

    def compiled(function: Callable[..., Any], fixed_shapes: bool = False) -> Kernel:
        # the only one in which callables are called in a loop
        fixed_numbers = is_double and function is attempt
        problem = label(dynamics)
        return _kernel(key, function, longest, device, fixed_shapes, fixed_numbers, problem)

    model = curvature.local_model(is_shared(dynamics) and device == "cpu", compiled)
    return Kernels(model, policy, compiled(attempt), free)


def _options(device: str) -> dict[str, Any]:
    """Loops over time in C++ on a CPU, which is faster by microseconds; graphs kept on disk.

    The compiler does not keep graphs with loops unless told that the loop is safe to keep, which it
    is: its body is a part of the graph that is hashed.
    """
    import torch._inductor.config

    from diffstack_mmv.control.separate_lanes import SeparateLanes

    options: dict[str, Any] = {"loop_ordering_after_fusion": False}  # slow, and finds nothing here
    if device == "cpu":
        options["cpp_wrapper"] = True
        options["post_grad_custom_post_pass"] = SeparateLanes()
    if hasattr(torch._inductor.config, "unsafe_marked_cacheable_functions"):
        loops = {f"torch.ops.higher_order.{name}": "body hashed" for name in ("scan", "while_loop")}
        options["unsafe_marked_cacheable_functions"] = loops
    return options


@functools.cache
def retain_freed_memory() -> None:
    """Free one large block, so that the C library keeps what the kernels free for their next call.

    It would otherwise return the memory of every local model to the system and have it mapped and
    cleared again: a fifth of the time of a solve.
    """
    torch.empty(RETAINED, dtype=torch.uint8)


def _mark_varying(arguments: tuple[Any, ...]) -> None:
    """Tell the compiler which sizes vary, batch and horizon, so that others need no new graph.

    The tensors that the callables hide have to be told as well: one of a fixed size that meets a
    batch in an operation would fix the batch.
    """
    from torch._dynamo.decorators import maybe_mark_dynamic

    tensors = [tensor for argument in arguments for tensor in hidden_tensors(argument)]
    sizes = {
        size
        for argument in arguments
        if not callable(argument)
        for tensor in hidden_tensors(argument)
        for size in _outer(tensor)
    }
    for tensor in tensors:
        for dimension, size in enumerate(tensor.shape):
            if size in sizes:
                maybe_mark_dynamic(tensor, dimension)


def _outer(tensor: Tensor) -> list[int]:
    """Sizes of the first and last dimension that may be a horizon and a batch."""
    outer = (tensor.shape[0], tensor.shape[-1]) if tensor.dim() else ()
    return [size for size in outer if size > LARGEST_ROW]


def hidden_tensors(value: Any, depth: int = 4) -> Iterator[Tensor]:
    """Tensors in a record, or that a callable closes over; those of modules are left out.

    A parameter of a module is shared by all problems, so its sizes do not vary.
    """
    if isinstance(value, Tensor):
        yield value
    elif depth > 0 and not isinstance(value, torch.nn.Module):
        for part in _parts(value):
            yield from hidden_tensors(part, depth - 1)


def _parts(value: Any) -> Iterable[Any]:
    if isinstance(value, tuple | list):
        return value
    if isinstance(value, Batched):
        return (value.function, *value.tensors)
    if isinstance(value, functools.partial):
        return (value.func, *value.args, *value.keywords.values())
    cells = getattr(value, "__closure__", None) or ()
    return [cell.cell_contents for cell in cells]


def copied(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function with a code object of its own."""
    code = function.__code__.replace()
    copy = types.FunctionType(
        code,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy
