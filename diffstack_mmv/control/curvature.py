"""Forms of the curvature λ · ∂²f that the iterations see; a gradient has it exactly in any case."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.chunked import Chunked, pull
from diffstack_mmv.control.expansion import (
    Model,
    assemble,
    expand,
    expand_by_differences,
    value_along,
)
from diffstack_mmv.control.optimizer import Cost, Dynamics


@runtime_checkable
class LocalModel(Protocol):
    """Expands a problem around trajectories; `near` marks the problems close to their solution."""

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        like: Float[Tensor, "*b"],
        x: Float[Tensor, "T1 n N"],
        u: Float[Tensor, "T m N"],
        near: Bool[Tensor, " N"],
    ) -> Model:
        """Local model of every problem."""
        ...


@runtime_checkable
class KernelFactory(Protocol):
    """Makes a kernel of a function of module level."""

    def __call__(
        self, function: Callable[..., Any], fixed_shapes: bool = False
    ) -> Callable[..., Any]:
        """The function, or a compiled form of it; `fixed_shapes` if they are always the same."""
        ...


@runtime_checkable
class CurvatureForm(Protocol):
    """How the iterations come by the curvature of the dynamics."""

    def local_model(self, shared: bool, kernel: KernelFactory) -> LocalModel:
        """The expansion made of kernels; `shared` if all problems have the same dynamics."""
        ...

    def is_exact(self, columns: int) -> bool:
        """Whether every model of a state with so many columns has the exact Hessian."""
        ...


@dataclass(frozen=True)
class ExactCurvature:
    """The dynamics are differentiated twice, at every iteration."""

    def local_model(self, shared: bool, kernel: KernelFactory) -> LocalModel:
        """One kernel."""
        return kernel(expand)

    def is_exact(self, columns: int) -> bool:
        """Yes."""
        return True


@dataclass(frozen=True)
class DifferencedCurvature:
    """The exact gradient is differenced, and not before a problem is near its solution.

    Less work and smaller graphs for large models such as DiffGM3.
    """

    def local_model(self, shared: bool, kernel: KernelFactory) -> LocalModel:
        """One kernel, or for shared dynamics kernels that see chunks of one size."""
        if shared:
            return Chunked(kernel(pull, fixed_shapes=True), kernel(value_along), kernel(assemble))
        return kernel(expand_by_differences)

    def is_exact(self, columns: int) -> bool:
        """No: far from a solution a model goes without the curvature of the dynamics."""
        return False


@dataclass(frozen=True)
class CurvatureBySize:
    """Exact for small models, by differences for large ones: each where it takes less time.

    Args:
        large: Number of state columns from which on a model is large.
    """

    large: int = 6

    def local_model(self, shared: bool, kernel: KernelFactory) -> LocalModel:
        """The expansion of either form; a kernel is compiled at its first use."""
        exact = ExactCurvature().local_model(shared, kernel)
        differenced = DifferencedCurvature().local_model(shared, kernel)

        def chosen(
            dynamics: Dynamics, cost: Cost, like: Tensor, x: Tensor, u: Tensor, near: Tensor
        ) -> Model:
            model = exact if self.is_exact(x.shape[1]) else differenced
            return model(dynamics, cost, like, x, u, near)

        return chosen

    def is_exact(self, columns: int) -> bool:
        """Of a small model."""
        return columns < self.large
