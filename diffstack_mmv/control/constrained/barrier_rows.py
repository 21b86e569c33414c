"""Constraints as an interior-point method sees them: g + s - σ = 0 with s > 0, and h = 0."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.constraint import ConstraintRows


class BarrierRows(NamedTuple):
    """Inequalities, a soft equality being two of them, and the hard equalities.

    σ ≥ 0 is the violation of a soft row, at the price w₁ σ + ½ w₂ σ².
    """

    column: Int[Tensor, " I"]  # of the constraints, of each inequality
    sign: Float[Tensor, " I"]
    equality: Int[Tensor, " E"]  # columns of the hard equalities
    linear: Float[Tensor, "*b T1 I"]  # w₁, zero where hard
    quadratic: Float[Tensor, "*b T1 I"]  # w₂
    soft: Bool[Tensor, "*b T1 I"]
    applies: Bool[Tensor, "*b T1 I"]

    def inequalities(self, values: Float[Tensor, "*b T1 K"]) -> Float[Tensor, "*b T1 I"]:
        """Values of the inequalities."""
        return values[..., self.column] * self.sign

    def select(self, index: Int[Tensor, " k"]) -> "BarrierRows":
        """The rows of some problems of a batch with one leading dimension."""
        return self._replace(
            linear=self.linear[index],
            quadratic=self.quadratic[index],
            soft=self.soft[index],
            applies=self.applies[index],
        )

    def multipliers(
        self, z: Float[Tensor, "*b T1 I"], y: Float[Tensor, "*b T1 E"], columns: int
    ) -> Float[Tensor, "*b T1 K"]:
        """Multipliers of the constraints from those of the inequalities and equalities."""
        whole = z.new_zeros(*z.shape[:-1], columns)
        whole.index_add_(-1, self.column, z * self.sign)
        return whole.index_add_(-1, self.equality, y)


def barrier_rows(rows: ConstraintRows) -> BarrierRows:
    """Sort the columns of the constraints."""
    K = len(rows.signed)
    hard = (rows.linear.isinf() | ~rows.applies).reshape(-1, K).all(0)
    strict = rows.signed & hard
    loose = rows.signed & ~strict
    plain, twice, equality = (part.nonzero().squeeze(-1) for part in (~rows.signed, loose, strict))
    column = torch.cat([plain, twice, twice])
    one = torch.ones(len(column), dtype=rows.linear.dtype, device=column.device)
    one[len(plain) + len(twice) :] = -1
    linear, quadratic = rows.linear[..., column], rows.quadratic[..., column]
    priced = (linear > 0) | (quadratic > 0)
    soft = linear.isfinite()
    return BarrierRows(
        column,
        one,
        equality,
        torch.where(soft, linear, torch.zeros_like(linear)),
        quadratic,
        soft,
        priced & rows.applies[:, column],
    )
