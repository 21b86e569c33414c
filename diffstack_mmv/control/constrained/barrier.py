"""The barrier problem: its unknowns and its measures."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.barrier_rows import BarrierRows
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.expansion import pad_controls, step_all


class Interior(NamedTuple):
    """Unknowns of every problem."""

    x: Float[Tensor, "*b T1 n"]
    u: Float[Tensor, "*b T m"]
    s: Float[Tensor, "*b T1 I"]  # slack of the inequalities
    sigma: Float[Tensor, "*b T1 I"]  # violation of the soft ones
    z: Float[Tensor, "*b T1 I"]
    y: Float[Tensor, "*b T1 E"]
    lower: Float[Tensor, "*b T m"]  # multipliers of the bounds
    upper: Float[Tensor, "*b T m"]

    def moved(
        self, step: "Interior", primal: Float[Tensor, "*b"], dual: Float[Tensor, "*b"]
    ) -> "Interior":
        """After a step of these sizes."""
        sizes = [primal] * 4 + [dual] * 4
        triples = zip(self, step, sizes, strict=True)
        return Interior(*(own + size[..., None, None] * d for own, d, size in triples))


class BarrierResidual(NamedTuple):
    """How far unknowns are from the equations."""

    defect: Float[Tensor, "*b T n"]  # f(x, u) - x⁺
    unequal: Float[Tensor, "*b T1 I"]  # g + s - σ
    equal: Float[Tensor, "*b T1 E"]  # h

    @property
    def total(self) -> Float[Tensor, "*b"]:
        """Sum of all absolute values."""
        return sum(part.abs().sum((-2, -1)) for part in self)  # pyright: ignore


class Barrier(NamedTuple):
    """A batch of barrier problems, the cost multiplied by `scale`."""

    problem: Problem
    rows: BarrierRows
    scale: Float[Tensor, "*b"]

    def select(self, index: Int[Tensor, " k"]) -> "Barrier":
        """Some of the problems of a batch with one leading dimension."""
        return Barrier(self.problem.select(index), self.rows.select(index), self.scale[index])

    def gaps(self, u: Float[Tensor, "*b T m"]) -> tuple[Tensor, Tensor]:
        """Distances from the bounds, infinite where there is none or the control is fixed."""
        low, high = self.problem.bounds
        fixed = torch.where(low == high, torch.inf, 0.0).to(u)
        return u - low + fixed, high - u + fixed

    def residual(self, point: Interior) -> BarrierResidual:
        """Defects and constraints."""
        values = self.problem.rows.values(point.x, pad_controls(point.u))
        following = step_all(self.problem.dynamics, point.x[..., :-1, :], point.u)
        unequal = self.rows.inequalities(values) + point.s - point.sigma
        return BarrierResidual(
            following - point.x[..., 1:, :],
            torch.where(self.rows.applies, unequal, torch.zeros_like(unequal)),
            values[..., self.rows.equality],
        )

    def objective(self, point: Interior, mu: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """Cost and barriers."""
        rows = self.rows
        paid = rows.linear * point.sigma + 0.5 * rows.quadratic * point.sigma.square()
        cost = self.problem.cost(point.x, pad_controls(point.u)).sum(-1)
        cost = self.scale * (cost + torch.where(rows.soft, paid, 0.0).sum((-2, -1)))
        logs = torch.where(rows.applies, point.s, 1.0).log().sum((-2, -1))
        logs = logs + torch.where(self.yields, point.sigma, 1.0).log().sum((-2, -1))
        for gap in self.gaps(point.u):
            logs = logs + torch.where(gap.isfinite(), gap, 1.0).log().sum((-2, -1))
        return cost - mu * logs

    @property
    def yields(self) -> Bool[Tensor, "*b T1 I"]:
        """Rows that may be violated at a price."""
        return self.rows.applies & self.rows.soft

    def spare(self, point: Interior) -> Float[Tensor, "*b T1 I"]:
        """What the price of a violation exceeds the multiplier by, one for hard rows."""
        price = self.rows.linear + self.rows.quadratic * point.sigma
        price = self.scale[..., None, None] * price
        return torch.where(self.yields, price - point.z, torch.ones_like(point.z))

    def multipliers(self, point: Interior) -> Float[Tensor, "*b T1 K"]:
        """Multipliers of the constraints, of the scaled cost."""
        return self.rows.multipliers(point.z, point.y, len(self.problem.rows.signed))
