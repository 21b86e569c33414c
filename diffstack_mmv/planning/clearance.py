"""Whether a plan keeps clear of agents: clearance within its steps, and the margins asked."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between, require_positive
from diffstack_mmv.geometry import direction, times_ahead
from diffstack_mmv.types import Discs, Motion, Obstacles


def disc_centres(motion: Motion, discs: Discs) -> Float[Tensor, "*b C D T1 2"]:
    """Centres in m of the discs (`*b D`) of vehicles that move like this (`*b C T1`)."""
    ahead = discs.ahead[..., None, :, None, None]
    position, forward = motion.position.unsqueeze(-3), direction(motion.heading).unsqueeze(-3)
    # a disc at the reference point is there exactly
    return torch.where(ahead == 0, position, position + ahead * forward)


def clearance_within_steps(
    motion: Motion, discs: Discs, obstacles: Obstacles
) -> Float[Tensor, "*b C N K T"]:
    """Smallest clearance in m within each step, all moving straight between their points.

    Args:
        motion: Motions of the plans, `*b C T1`.
        discs: Discs around the vehicle, `*b D`.
        obstacles: Agents at the same times, `*b N K T1`; who is not valid is infinitely far away.

    Returns:
        Clearance in m, negative for an overlap.
    """
    centre = disc_centres(motion, discs)[..., None, None, :, :]
    relative = obstacles.position[..., None, None, :, :, :, :] - centre
    distance = _from_origin(relative).sqrt()
    reach = discs.radius.unsqueeze(-1) + obstacles.radius.unsqueeze(-2)
    clearance = (distance - reach[..., None, :, :, None, None]).amin(-4)
    return torch.where(obstacles.valid[..., None, :, None, None], clearance, torch.inf)


def _from_origin(points: Float[Tensor, "*b T1 2"]) -> Float[Tensor, "*b T"]:
    """Squared distance in m² of the origin to each straight piece of a path.

    Plans are compared by it, many thousands at a time, so it is rounded as it comes; verdicts use
    the correctly rounded `distance_to_segment`.
    """
    x, y = points.unbind(-1)
    start_x, start_y, step_x, step_y = x[..., :-1], y[..., :-1], x.diff(dim=-1), y.diff(dim=-1)
    squared = (step_x.square() + step_y.square()).clamp_min(torch.finfo(points.dtype).tiny)
    along = -(start_x * step_x + start_y * step_y) / squared
    along = along.clamp(0, 1)
    return (
        torch.addcmul(start_x, along, step_x).square()
        + torch.addcmul(start_y, along, step_y).square()
    )


class Safety(NamedTuple):
    """How safe plans are, `*b C`."""

    safe: Bool[Tensor, "*b C"]
    penalty: Float[Tensor, "*b C"]  # m² s, expected lack of comfortable clearance, squared
    shortfall: Float[Tensor, "*b C"]  # m, largest lack of clearance with near times weighing most


@dataclass(frozen=True)
class ClearanceMargin:
    """Clearance asked of a plan: m = m_0 + growth · min(s, saturation), hard and comfortable.

    s is the way that an agent is predicted to have gone by then: who stands still is predicted
    well, who walks may turn. A plan is refused where it falls below the hard margin to any
    component of any agent that is likely enough; the comfortable one counts in expectation.

    Attributes:
        hard_m: m_0 below which a plan is refused.
        hard_growth: Growth of it per metre walked, for the error of the forecast.
        comfort_m: m_0 below which a plan is penalised.
        comfort_growth: Growth of it per metre walked.
        saturation_m: Way from which on both margins stay.
        horizon_s: Refusal looks no further ahead than this.
        probability_min: Components less likely than this refuse no plan.
        spread_growth: Standard deviation of an agent's position per metre walked, without end, for
            the risk: at a clearance c and a deviation σ the probability of contact is about
            r² / (r² + 2 σ²) exp(-c² / (2 σ²)), one or none for a sure forecast, and for a vague one
            the density of agents times the area of contact.
        reach_m: r, the distance of the centres at contact.
        turn_rate: How often an agent takes to another course, 1/s; after a time t the deviation is
            that of `turn_growth` with the probability 1 - exp(-rate t).
        turn_growth: Standard deviation per metre walked of who did.

    Raises:
        ValueError: A margin is negative, the way or the time not positive, or the probability
            outside of [0, 1].
    """

    hard_m: float = 0.05
    hard_growth: float = 0.05
    comfort_m: float = 0.25
    comfort_growth: float = 0.1
    saturation_m: float = 1.5
    horizon_s: float = 2.0
    probability_min: float = 0.05
    spread_growth: float = 0.25
    reach_m: float = 0.6
    turn_rate: float = 0.0
    turn_growth: float = 0.8

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("hard_m", "hard_growth", "comfort_m", "comfort_growth"):
            require_at_least(name, getattr(self, name), 0)
        require_positive("saturation_m", self.saturation_m)
        require_positive("horizon_s", self.horizon_s)
        require_at_least("spread_growth", self.spread_growth, 0)
        require_positive("reach_m", self.reach_m)
        require_at_least("turn_rate", self.turn_rate, 0)
        require_at_least("turn_growth", self.turn_growth, 0)
        require_between("probability_min", self.probability_min, 0, 1)

    def __call__(
        self, clearance: Float[Tensor, "*b C N K T"], obstacles: Obstacles, dt_s: float
    ) -> Safety:
        """Judge plans by their clearance (m) in each step of `dt_s`.

        Args:
            clearance: Smallest clearance to each component of each agent within each step in m.
            obstacles: The agents, for the way that each has gone and the weight of its components.
            dt_s: Length of a step in s.

        Returns:
            The judgement.
        """
        time = times_ahead(clearance, clearance.shape[-1], dt_s)
        way = _gone(obstacles).clamp(max=self.saturation_m).unsqueeze(-4)
        weight = obstacles.weight[..., None, :, :, None]
        lack = self.hard_m + self.hard_growth * way - clearance
        counts = (time <= self.horizon_s + 1e-6) & (weight >= self.probability_min)
        lack = torch.where(counts, lack, -torch.inf).clamp_min(0)
        discomfort = (self.comfort_m + self.comfort_growth * way - clearance).clamp_min(0)
        return Safety(
            safe=(lack == 0).flatten(-3).all(-1),
            penalty=(weight * discomfort.square()).sum((-3, -2, -1)) * dt_s,
            shortfall=_largest(lack / (1 + time)),
        )

    def risk(
        self, clearance: Float[Tensor, "*b C N K T"], obstacles: Obstacles, dt_s: float
    ) -> Float[Tensor, "*b C"]:
        """Expected time of contact in s; arguments as above."""
        gone = _gone(obstacles).unsqueeze(-4)
        contact = self._contact(clearance, self.spread_growth * gone)
        if self.turn_rate > 0:
            time = times_ahead(clearance, clearance.shape[-1], dt_s)
            turned = -torch.expm1(-self.turn_rate * time)
            contact = contact + turned * (
                self._contact(clearance, self.turn_growth * gone) - contact
            )
        return (obstacles.weight[..., None, :, :, None] * contact).sum((-3, -2, -1)) * dt_s

    def _contact(
        self, clearance: Float[Tensor, "*b C N K T"], deviation: Float[Tensor, "*b 1 N K T"]
    ) -> Float[Tensor, "*b C N K T"]:
        """Probability of contact at a clearance in m, with agents known to a deviation in m."""
        variance = deviation.square().clamp_min(1e-4)
        certain = self.reach_m**2 / (self.reach_m**2 + 2 * variance)
        return certain * (-0.5 * clearance.clamp_min(0).square() / variance).exp()


def _gone(obstacles: Obstacles) -> Float[Tensor, "*b N K T"]:
    """Way in m that each component of each agent has gone after each step."""
    return obstacles.position.diff(dim=-2).square().sum(-1).sqrt().cumsum(-1)


def _largest(lack: Float[Tensor, "*b C N K T"]) -> Float[Tensor, "*b C"]:
    """Largest lack of a plan in m, zero where nobody is around."""
    flat = lack.flatten(-3)
    return flat.amax(-1) if flat.shape[-1] else flat.sum(-1)
