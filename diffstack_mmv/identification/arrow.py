"""Normal equations with a block per track and a border for what the tracks share.

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


class Arrow(NamedTuple):
    """Gauss-Newton Hessian and gradient."""

    own: Float[Tensor, "N z z"]  # H_i, positive definite
    cross: Float[Tensor, "N z p"]  # C_i
    shared: Float[Tensor, "p p"]  # P
    own_gradient: Float[Tensor, "N z"]
    shared_gradient: Float[Tensor, " p"]

    def scaled(self, factor: Float[Tensor, " p"]) -> "Arrow":
        """The equations for θ / factor instead of θ."""
        return self._replace(
            cross=self.cross * factor,
            shared=self.shared * factor * factor.unsqueeze(-1),
            shared_gradient=self.shared_gradient * factor,
        )

    def restricted(self, active: Bool[Tensor, " p"]) -> "Arrow":
        """The equations with the other entries of θ held."""
        return self._replace(
            cross=self.cross[..., active],
            shared=self.shared[active][:, active],
            shared_gradient=self.shared_gradient[active],
        )

    def damped(self, own: Float[Tensor, " N"], shared: Float[Tensor, ""]) -> "Arrow":
        """Raise the diagonals by these shares (Levenberg and Marquardt)."""
        block = self.own + torch.diag_embed(own.unsqueeze(-1) * self.own.diagonal(dim1=-2, dim2=-1))
        border = self.shared + torch.diag_embed(shared * self.shared.diagonal())
        return self._replace(own=block, shared=border)


class Reduced(NamedTuple):
    """What is left for θ when the tracks are eliminated."""

    information: Float[Tensor, "p p"]  # S
    gradient: Float[Tensor, " p"]


class ArrowStep(NamedTuple):
    """Solution of the normal equations."""

    own: Float[Tensor, "N z"]
    shared: Float[Tensor, " p"]


def reduce(arrow: Arrow) -> Reduced:
    """Eliminate the tracks."""
    factor = torch.linalg.cholesky(arrow.own)
    half = torch.linalg.solve_triangular(factor, arrow.cross, upper=False)
    right = torch.linalg.solve_triangular(factor, arrow.own_gradient.unsqueeze(-1), upper=False)
    information = arrow.shared - (half.mT @ half).sum(0)
    gradient = arrow.shared_gradient - (half.mT @ right).sum(0).squeeze(-1)
    return Reduced(0.5 * (information + information.mT), gradient)


class Box(NamedTuple):
    """How far θ may move in one step."""

    lower: Float[Tensor, " p"]
    upper: Float[Tensor, " p"]


def solve(arrow: Arrow, box: Box | None = None) -> ArrowStep:
    """Newton step: θ from the Schur complement, then each track for itself.

    Args:
        arrow: The equations.
        box: Bounds of the step of θ.
    """
    reduced = reduce(arrow)
    shared = newton(reduced) if box is None else bounded(reduced, box)
    right = arrow.own_gradient + arrow.cross @ shared
    own = -torch.cholesky_solve(right.unsqueeze(-1), torch.linalg.cholesky(arrow.own))
    return ArrowStep(own.squeeze(-1), shared)


def newton(reduced: Reduced) -> Float[Tensor, " p"]:
    """Step to the minimum, -S⁻¹ g."""
    return -torch.linalg.solve(reduced.information, reduced.gradient)


def bounded(reduced: Reduced, box: Box) -> Float[Tensor, " p"]:
    """Step to the minimum inside a box: entries that leave it stop at its wall, one set at a time.

    An entry that was stopped is not released again within this step; the next one looks anew.
    """
    step = torch.zeros_like(reduced.gradient)
    free = torch.ones_like(step, dtype=torch.bool)
    for _ in range(len(step) + 1):
        gradient = reduced.gradient + reduced.information @ torch.where(free, 0.0, step)
        part = Reduced(reduced.information[free][:, free], gradient[free])
        step[free] = newton(part)
        outside = free & ((step < box.lower) | (step > box.upper))
        step = torch.minimum(torch.maximum(step, box.lower), box.upper)
        if not bool(outside.any()):
            break
        free &= ~outside
    return step
