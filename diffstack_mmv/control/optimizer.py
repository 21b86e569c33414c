"""What other folders see of the control layer: the optimiser, and what it is given."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.types import Bounds, Solution


@runtime_checkable
class Dynamics(Protocol):
    """One control step x⁺ = f(x, u)."""

    def __call__(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"], /
    ) -> Float[Tensor, "*b n"]:
        """State after one step."""
        ...


@runtime_checkable
class LinearisedDynamics(Protocol):
    """Dynamics that know their own Jacobian, which spares automatic differentiation."""

    def jacobian(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> tuple[Float[Tensor, "*b n n"], Float[Tensor, "*b n m"]]:
        """A = ∂f/∂x and B = ∂f/∂u."""
        ...


@runtime_checkable
class Cost(Protocol):
    """Cost per time; entry t sees x_t and u_t only, and the last row of the controls is zero."""

    def __call__(
        self, states: Float[Tensor, "*b T1 n"], controls: Float[Tensor, "*b T1 m"], /
    ) -> Float[Tensor, "*b T1"]:
        """Cost c_0 .. c_T."""
        ...


@runtime_checkable
class TrajectoryOptimizer(Protocol):
    """Minimises Σ c_t(x_t, u_t) over controls in a box, x_{t+1} = f(x_t, u_t), for a batch."""

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        bounds: Bounds,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
    ) -> Solution:
        """Solve from the initial state and a guess of the controls.

        Returns:
            The solution, differentiable in the state and in every tensor that the two callables
            depend on.
        """
        ...


@runtime_checkable
class ConstraintFunction(Protocol):
    """Constrained quantities per time; entry t sees x_t and u_t only, as the entries of a cost."""

    def __call__(
        self, states: Float[Tensor, "*b T1 n"], controls: Float[Tensor, "*b T1 m"], /
    ) -> Float[Tensor, "*b T1 k"]:
        """Values at times 0 .. T; the last row of the controls is zero."""
        ...


@dataclass(frozen=True)
class Constraints:
    """g(x_t, u_t) ≤ 0 and h(x_t, u_t) = 0 at all times 0 .. T, both hard.

    Args:
        inequality: Gives g; None if there is none.
        equality: Gives h.
    """

    inequality: ConstraintFunction | None = None
    equality: ConstraintFunction | None = None
