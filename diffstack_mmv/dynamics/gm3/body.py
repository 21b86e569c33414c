"""Velocity of the body: v' = A v + b in exact secant form, and the 3x3 algebra on it.

v = (v_x, v_y, r) at the centre of gravity. With the secants of the tyres at the present state,
v' = A v + b equals identically

    m v_x' = ΣF_x,b + m r v_y
    m v_y' = ΣF_y,b - m r v_x
    I_z r' = Σ(k_align M_z + x F_y,b - y F_x,b) - I_z d_yaw r

Frozen over a step, A is dissipative.

Source:
    GM3, Eq. 10-14; DMMV, Sec. IV-B; the Coriolis terms are not printed there, but steady cornering
    needs them.
"""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class LinearEquation(NamedTuple):
    """v' = A v + b."""

    matrix: Float[Tensor, "3 3 n"]  # A
    offset: Float[Tensor, "3 n"]  # b

    def rate(self, velocity: Float[Tensor, "3 n"]) -> Float[Tensor, "3 n"]:
        """A v + b, in m/s² and rad/s²."""
        return times(self.matrix, velocity) + self.offset


def times(matrix: Float[Tensor, "3 3 n"], vector: Float[Tensor, "3 n"]) -> Float[Tensor, "3 n"]:
    """Matrix times vector, elementwise over the batch."""
    return (matrix * vector).sum(1)


def outer_sum(
    left: Float[Tensor, "3 wheels #n"], right: Float[Tensor, "3 wheels #n"]
) -> Float[Tensor, "3 3 n"]:
    """Σ over the wheels of left ⊗ right."""
    return (left.unsqueeze(1) * right).sum(2)


class Factored(NamedTuple):
    """A 3x3 matrix, ready to be solved with."""

    inverse_rows: Float[Tensor, "3 3 n"]  # cofactors over determinant: the inverse, transposed

    def solve(self, vector: Float[Tensor, "3 n"]) -> Float[Tensor, "3 n"]:
        """Inverse times vector."""
        return (self.inverse_rows * vector.unsqueeze(1)).sum(0)


def factored(matrix: Float[Tensor, "3 3 n"]) -> Factored:
    """Prepare a 3x3 matrix: the rows of its cofactors are cross products of its rows."""
    upper, lower = matrix.roll((-1, -1), (0, 1)), matrix.roll((-2, -2), (0, 1))
    left, right = matrix.roll((-1, -2), (0, 1)), matrix.roll((-2, -1), (0, 1))
    cofactors = upper * lower - left * right
    return Factored(cofactors / (matrix[0] * cofactors[0]).sum(0))
