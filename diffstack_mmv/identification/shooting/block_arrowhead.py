"""Block-arrowhead normal equations: a block per track, bordered by the shared parameters.

    [ H_1           C_1 ] [ z_1 ]     [ g_1 ]
    [      ...          ] [ ... ] = - [ ... ]
    [ C_1ᵀ  ...     P   ] [  θ  ]     [  q  ]

Eliminating the tracks leaves the Schur complement S = P - Σ C_iᵀ H_i⁻¹ C_i: the information about
θ with the unknowns of all tracks marginalised.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor


class BlockArrowhead(NamedTuple):
    """Gauss-Newton Hessian and gradient of local unknowns z_i and shared parameters θ."""

    local: Float[Tensor, "N z z"]  # H_i, positive definite
    cross: Float[Tensor, "N z p"]  # C_i
    shared: Float[Tensor, "p p"]  # P
    local_gradient: Float[Tensor, "N z"]
    shared_gradient: Float[Tensor, " p"]

    def scaled(self, factor: Float[Tensor, " p"]) -> "BlockArrowhead":
        """The equations for θ / factor instead of θ."""
        return self._replace(
            cross=self.cross * factor,
            shared=self.shared * factor * factor.unsqueeze(-1),
            shared_gradient=self.shared_gradient * factor,
        )

    def restricted(self, active: Bool[Tensor, " p"]) -> "BlockArrowhead":
        """The equations with the other entries of θ fixed."""
        return self._replace(
            cross=self.cross[..., active],
            shared=self.shared[active][:, active],
            shared_gradient=self.shared_gradient[active],
        )

    def damped(self, local: Float[Tensor, " N"], shared: Float[Tensor, ""]) -> "BlockArrowhead":
        """Raise the diagonals by these relative amounts (Levenberg and Marquardt)."""
        block = self.local + torch.diag_embed(
            local.unsqueeze(-1) * self.local.diagonal(dim1=-2, dim2=-1)
        )
        border = self.shared + torch.diag_embed(shared * self.shared.diagonal())
        return self._replace(local=block, shared=border)


class ReducedSystem(NamedTuple):
    """The equations for θ after the tracks are eliminated."""

    information: Float[Tensor, "p p"]  # S
    gradient: Float[Tensor, " p"]


class BlockArrowheadStep(NamedTuple):
    """Solution of the normal equations."""

    local: Float[Tensor, "N z"]
    shared: Float[Tensor, " p"]


def eliminate_tracks(system: BlockArrowhead) -> ReducedSystem:
    """Eliminate the tracks: the Schur complement and its gradient."""
    factor = torch.linalg.cholesky(system.local)
    half = torch.linalg.solve_triangular(factor, system.cross, upper=False)
    right = torch.linalg.solve_triangular(factor, system.local_gradient.unsqueeze(-1), upper=False)
    information = system.shared - (half.mT @ half).sum(0)
    gradient = system.shared_gradient - (half.mT @ right).sum(0).squeeze(-1)
    return ReducedSystem(0.5 * (information + information.mT), gradient)


class StepBounds(NamedTuple):
    """Bounds of one step of θ."""

    lower: Float[Tensor, " p"]
    upper: Float[Tensor, " p"]


def solve_arrowhead(system: BlockArrowhead, box: StepBounds | None = None) -> BlockArrowheadStep:
    """Newton step: θ from the Schur complement, then each track for itself.

    Args:
        system: The equations.
        box: Bounds of the step of θ.
    """
    reduced = eliminate_tracks(system)
    shared = newton_step(reduced) if box is None else bounded_newton_step(reduced, box)
    right = system.local_gradient + system.cross @ shared
    local = -torch.cholesky_solve(right.unsqueeze(-1), torch.linalg.cholesky(system.local))
    return BlockArrowheadStep(local.squeeze(-1), shared)


def newton_step(reduced: ReducedSystem) -> Float[Tensor, " p"]:
    """Step to the minimum, -S⁻¹ g."""
    return -torch.linalg.solve(reduced.information, reduced.gradient)


def bounded_newton_step(reduced: ReducedSystem, box: StepBounds) -> Float[Tensor, " p"]:
    """Step to the minimum inside a box: entries that leave it are fixed at its bounds, set by set.

    An entry that was fixed is not released within this step.
    """
    step = torch.zeros_like(reduced.gradient)
    free = torch.ones_like(step, dtype=torch.bool)
    for _ in range(len(step) + 1):
        gradient = reduced.gradient + reduced.information @ torch.where(free, 0.0, step)
        part = ReducedSystem(reduced.information[free][:, free], gradient[free])
        step[free] = newton_step(part)
        outside = free & ((step < box.lower) | (step > box.upper))
        step = torch.minimum(torch.maximum(step, box.lower), box.upper)
        if not bool(outside.any()):
            break
        free &= ~outside
    return step
