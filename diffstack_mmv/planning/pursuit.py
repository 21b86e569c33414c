"""Pure pursuit of a course or of the goal: the arc on which a vehicle leaves its state."""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.planning.candidates import Arc

CREEP_MPS = 0.3
"""A turn to the goal slows down no further than to this."""


class Leg(NamedTuple):
    """What candidates do in one step."""

    offset: Float[Tensor, "*b"]  # rad
    speed_share: Float[Tensor, "*b"]
    detours: Bool[Tensor, "*b"]  # false: it makes for the goal


@dataclass(frozen=True)
class Pursuit:
    """Settings of the pursuit, which drives every leg.

    Attributes:
        turn_time_s: Time in which an error of the course is steered out.
        lateral_mps2: Largest lateral acceleration of a turn.
        yaw_rate_radps: Largest yaw rate of the turn to the goal: what turns by driving its wheels
            apart turns tighter the slower it drives.
        braking_mps2: Deceleration towards the goal.
        backing_mps: Largest speed backwards.

    Raises:
        ValueError: A number is not positive.
    """

    turn_time_s: float = 0.3
    lateral_mps2: float = 4.0
    yaw_rate_radps: float = 2.5
    braking_mps2: float = 2.5
    backing_mps: float = 1.0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for field in fields(self):
            require_positive(field.name, getattr(self, field.name))

    def arc(
        self,
        dynamics: DynamicsModel,
        state: Float[Tensor, "*b n"],
        leg: Leg,
        goal: Float[Tensor, "*b 2"],
        cruise: Float[Tensor, "*b"],
    ) -> Arc:
        """Arcs on which candidates leave their states, each for its leg.

        Args:
            dynamics: The vehicle.
            state: Of the candidates at the beginning of the step.
            leg: Of the candidates in this step.
            goal: In m.
            cruise: Cruising speed in m/s, which no target exceeds.
        """
        none = torch.zeros_like(dynamics.bounds.lower).to(state)
        motion = dynamics.motion(state, none.expand(*state.shape[:-1], len(none)))
        way = goal - motion.position
        distance = way.square().sum(-1).sqrt()
        bearing = torch.atan2(way[..., 1], way[..., 0]) + torch.where(leg.detours, leg.offset, 0.0)
        backwards = leg.detours & (leg.speed_share < 0)
        error = wrap_angle(bearing - motion.heading + torch.where(backwards, math.pi, 0.0))
        speed = motion.velocity[..., 0]
        # on the way to the goal no faster than its arc allows, or a fast vehicle would circle it
        turning = self._arc_speed(distance, error)
        share = (cruise * leg.speed_share).clamp_min(-self.backing_mps)
        target = torch.where(leg.detours, share, torch.minimum(cruise, turning))
        stopping = (2 * self.braking_mps2 * distance).sqrt()
        # at the start of the step the target must be one that the step can still brake for
        target = torch.minimum(target, stopping)
        moving = speed.abs().clamp_min(0.5)
        sharpest = self.lateral_mps2 / moving.square()
        curvature = error / (self.turn_time_s * moving)
        curvature = torch.minimum(torch.maximum(curvature, -sharpest), sharpest)
        # backwards the same turn is that of the opposite curvature
        curvature = torch.where(speed + target < 0, -curvature, curvature)
        return Arc((target - speed) / dynamics.dt_s, curvature)

    def _arc_speed(
        self, distance: Float[Tensor, "*b"], error: Float[Tensor, "*b"]
    ) -> Float[Tensor, "*b"]:
        """Speed in m/s on the arc to the goal, of radius d / (2 sin β), or d / 2 to a goal behind.

        Not below `CREEP_MPS`: in tighter turns the steering is the limit.
        """
        sine = torch.where(error.abs() < 0.5 * math.pi, error.abs().sin(), 1.0)
        radius = 0.5 * distance / sine.clamp_min(1e-3)
        fastest = (self.lateral_mps2 * radius).sqrt()
        return torch.minimum(fastest, self.yaw_rate_radps * radius).clamp_min(CREEP_MPS)
