"""Which rows of constraints hold a trajectory, and how."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.constrained.constraint import ConstraintRows


class Activity(NamedTuple):
    """What each row does: nothing, hold, give way in proportion, or press with a constant force."""

    active: Bool[Tensor, "*b T1 K"]  # the multiplier is an unknown
    saturated: Bool[Tensor, "*b T1 K"]  # the multiplier is its linear price
    compliance: Float[Tensor, "*b T1 K"]  # 1 / price where an active row gives way, else 0
    side: Float[Tensor, "*b T1 K"]  # sign of the violation of a row that gives way or is saturated
    offset: Float[Tensor, "*b T1 K"]  # multiplier at which it began to

    def multipliers(self, found: Float[Tensor, "*b T1 K"]) -> Float[Tensor, "*b T1 K"]:
        """Those found for the active rows, and what the others press with."""
        return torch.where(self.active, found, torch.where(self.saturated, self.offset, 0.0))

    def residual(
        self, values: Float[Tensor, "*b T1 K"], multipliers: Float[Tensor, "*b T1 K"]
    ) -> Float[Tensor, "*b T1 K"]:
        """What has to vanish on an active row: g less the slack of its multiplier."""
        yielded = self.compliance * (multipliers - self.offset)
        return torch.where(self.active, values - yielded, torch.zeros_like(values))


def classify(raw: Float[Tensor, "*b T1 K"], rows: ConstraintRows) -> Activity:
    """Activity by the sign of raw = ν + κ g, κ any positive number."""
    zero = torch.zeros_like(raw)
    low = torch.where(rows.signed, -rows.linear, zero)
    above, below = raw > rows.linear, (raw < -rows.linear) & rows.signed
    beyond = (above | below) & rows.applies
    yields = beyond & (rows.quadratic > 0)
    within = (raw > low) & (raw < rows.linear) & rows.applies
    side = torch.where(above, 1.0, torch.where(below, -1.0, zero))
    finite = torch.where(rows.linear.isfinite(), rows.linear, zero)
    price = torch.where(yields, rows.quadratic, torch.ones_like(zero))
    compliance = torch.where(yields, 1 / price, zero)
    return Activity(
        within | yields, beyond & ~yields, compliance, side, torch.where(beyond, side * finite, 0.0)
    )
