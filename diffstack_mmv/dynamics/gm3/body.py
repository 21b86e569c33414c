"""Velocity of the body: v' = A v + b in exact secant form, and the 3x3 algebra on it.

v = (v_x, v_y, r) at the centre of gravity. With the secants of the tyres at the present state, A v
+ b equals

    m v_x' = ΣF_x,b + m r v_y,   m v_y' = ΣF_y,b - m r v_x,
    I_z r' = Σ(k_align M_z + x F_y,b - y F_x,b) - I_z d_yaw r

identically; frozen over a step, A is dissipative. Source: GM3, Eq. 10-14; DMMV, Sec. IV-B; the
Coriolis terms are not printed there, but steady cornering needs them.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class LinearEquation(NamedTuple):
    """v' = A v + b."""

    matrix: Float[Tensor, "*b 3 3"]  # A
    offset: Float[Tensor, "*b 3"]  # b

    def rate(self, velocity: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3"]:
        """A v + b, in m/s² and rad/s²."""
        return times(self.matrix, velocity) + self.offset


def times(matrix: Float[Tensor, "*b 3 3"], vector: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3"]:
    """Matrix times vector; elementwise, which small matrices of a large batch prefer."""
    return (matrix * vector.unsqueeze(-2)).sum(-1)


def outer_sum(
    left: Float[Tensor, "*b 3 wheels"], right: Float[Tensor, "*b 3 wheels"]
) -> Float[Tensor, "*b 3 3"]:
    """Σ over the wheels of left ⊗ right."""
    return (left.unsqueeze(-2) * right.unsqueeze(-3)).sum(-1)


class Factored(NamedTuple):
    """A 3x3 matrix, ready to be solved with: its cofactors over its determinant."""

    adjugate: Float[Tensor, "*b 3 3"]  # rows are the columns of the inverse

    def solve(self, vector: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3"]:
        """Inverse times vector."""
        return (self.adjugate * vector.unsqueeze(-1)).sum(-2)


def factored(matrix: Float[Tensor, "*b 3 3"]) -> Factored:
    """Prepare a 3x3 matrix: the rows of its cofactors are cross products of its rows."""
    first, second, third = matrix.unbind(-2)
    cofactors = torch.linalg.cross(
        torch.stack([second, third, first], -2), torch.stack([third, first, second], -2)
    )
    determinant = (first * cofactors[..., 0, :]).sum(-1, keepdim=True)
    return Factored(cofactors / determinant.unsqueeze(-1))
