"""Whether a plan keeps clear of people: clearance within its steps, and the margins asked."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.simulation.collision import distance_to_segment


def clearance_of(
    position: Float[Tensor, "*b C T1 2"],
    people: Float[Tensor, "*b h T1 2"],
    reach: Float[Tensor, "*b h"],
) -> Float[Tensor, "*b C h T"]:
    """Smallest clearance in m within each step, both moving straight between their points.

    Args:
        position: Positions of the plans in m.
        people: Positions of the humans in m at the same times.
        reach: Sum of both radii in m.

    Returns:
        Clearance in m, negative for an overlap.
    """
    relative = people.unsqueeze(-4) - position.unsqueeze(-3)
    distance = distance_to_segment(relative[..., :-1, :], relative[..., 1:, :])
    return distance - reach[..., None, :, None]


class Safety(NamedTuple):
    """How safe plans are, `*b C`."""

    safe: Bool[Tensor, "*b C"]
    penalty: Float[Tensor, "*b C"]  # m², for clearances within the comfortable margin
    shortfall: Float[Tensor, "*b C"]  # m, largest lack of clearance with near times weighing most


@dataclass(frozen=True)
class SafetyMargin:
    """Clearance asked of a plan: m = m_0 + growth · min(s, saturation), hard and comfortable.

    s is the way that a human is predicted to have walked by then: who stands still is predicted
    well, who walks may turn.

    Attributes:
        hard_m: m_0 below which a plan is refused.
        hard_growth: Growth of it per metre walked, for the error of the forecast.
        comfort_m: m_0 below which a plan is penalised.
        comfort_growth: Growth of it per metre walked.
        saturation_m: Way from which on both margins stay.
        horizon_s: Refusal looks no further ahead than this.

    Raises:
        ValueError: A margin is negative, or the way or the time not positive.
    """

    hard_m: float = 0.05
    hard_growth: float = 0.05
    comfort_m: float = 0.25
    comfort_growth: float = 0.1
    saturation_m: float = 1.5
    horizon_s: float = 2.0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("hard_m", "hard_growth", "comfort_m", "comfort_growth"):
            require_at_least(name, getattr(self, name), 0)
        require_positive("saturation_m", self.saturation_m)
        require_positive("horizon_s", self.horizon_s)

    def __call__(
        self, clearance: Float[Tensor, "*b C h T"], walked: Float[Tensor, "*b 1 h T"], dt_s: float
    ) -> Safety:
        """Judge plans by their clearance (m) in each step of `dt_s`.

        Args:
            clearance: Smallest clearance to each human within each step in m.
            walked: Way of each human up to the end of each step in m.
            dt_s: Length of a step in s.

        Returns:
            The judgement.
        """
        steps = clearance.shape[-1]
        time = dt_s * torch.arange(1, steps + 1, dtype=clearance.dtype, device=clearance.device)
        way = walked.clamp(max=self.saturation_m)
        lack = self.hard_m + self.hard_growth * way - clearance
        lack = torch.where(time <= self.horizon_s + 1e-6, lack, -torch.inf).clamp_min(0)
        discomfort = (self.comfort_m + self.comfort_growth * way - clearance).clamp_min(0)
        return Safety(
            safe=(lack == 0).all(-1).all(-1),
            penalty=discomfort.square().sum((-2, -1)) * dt_s,
            shortfall=(lack / (1 + time)).amax((-2, -1)),
        )
