"""Result of a batch of constrained trajectory optimisations."""

from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.types import Solution, SolverStatus


class ConstrainedSolution(NamedTuple):
    """Trajectories, multipliers and one status per problem."""

    states: Float[Tensor, "*b T1 n"]
    controls: Float[Tensor, "*b T m"]
    cost: Float[Tensor, "*b"]  # with the price of violated soft constraints
    residual: Float[Tensor, "*b"]  # largest entry of the projected gradient of the Lagrangian
    iterations: Int[Tensor, "*b"]  # of all phases
    status: Int[Tensor, "*b"]  # a SolverStatus
    violation: Float[Tensor, "*b"]  # largest one of a hard constraint, in its unit
    multipliers: tuple[Float[Tensor, "*b T1 k"], ...]  # one per constraint

    def replaced(
        self, index: Int[Tensor, " k"], part: "ConstrainedSolution"
    ) -> "ConstrainedSolution":
        """With the problems `index` of a batch with one leading dimension taken from `part`."""

        def merged(old: Tensor, new: Tensor) -> Tensor:
            return old.index_copy(0, index, new)

        multipliers = tuple(map(merged, self.multipliers, part.multipliers))
        return ConstrainedSolution(*[*map(merged, self[:-1], part[:-1]), multipliers])

    @property
    def converged(self) -> Bool[Tensor, "*b"]:
        """Which problems converged."""
        return self.status == SolverStatus.CONVERGED

    @property
    def infeasible(self) -> Bool[Tensor, "*b"]:
        """Which problems ended where no step lowers the violation."""
        return self.status == SolverStatus.INFEASIBLE

    @property
    def solution(self) -> Solution:
        """What a solver without constraints returns."""
        return Solution(*self[:6])
