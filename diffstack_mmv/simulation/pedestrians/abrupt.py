"""Pedestrians who stop, or step into the way, right in front of a robot."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between, require_positive
from diffstack_mmv.geometry import length, wrap_angle
from diffstack_mmv.simulation.pedestrians.base import Crowd, CrowdState, VisibleRobot
from diffstack_mmv.simulation.pedestrians.sudden import random_looking

SLOW_MPS = 0.5
"""A robot that is slower startles nobody."""


@dataclass(frozen=True)
class AbruptCrowd:
    """Another crowd, whose members do the wrong thing where a robot comes towards them.

    Who is ahead of a moving robot and near stops, or steps onto the line on which the robot drives.
    What somebody does is drawn from a hash of where it stands, as in `SuddenCrowd`. They see the
    robot in this alone: otherwise they walk as if it was not there.

    Attributes:
        crowd: What they do otherwise.
        near_m: Clearance from which on somebody may do so.
        view_deg: Angle around the velocity of the robot within which somebody is ahead.
        stop_chance: Probability per step of standing still.
        step_chance: Probability per step of going onto the robot's line.
        speed_mps: With which somebody does.
        seed: Of the draws.

    Raises:
        ValueError: A probability lies outside of [0, 1], a length or speed is not positive, or the
            seed negative.
    """

    crowd: Crowd
    near_m: float = 2.0
    view_deg: float = 120.0
    stop_chance: float = 0.3
    step_chance: float = 0.3
    speed_mps: float = 1.0
    seed: int = 0

    reactive = True

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("stop_chance", "step_chance"):
            require_between(name, getattr(self, name), 0, 1)
        for name in ("near_m", "view_deg", "speed_mps"):
            require_positive(name, getattr(self, name))
        require_at_least("seed", self.seed, 0)

    def __call__(
        self, crowd: CrowdState, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "*b h 2"]:
        """Velocities in m/s for the next step."""
        velocity = self.crowd(crowd, dt_s)
        if robot is None or crowd.radius.shape[-1] == 0:
            return velocity
        startled = self._startled(crowd, robot)
        draw = random_looking(crowd.position, 3, self.seed)
        stops = startled & (draw < self.stop_chance)
        steps = startled & (draw > 1 - self.step_chance)
        velocity = torch.where(steps[..., None], self._onto_the_line(crowd, robot), velocity)
        return torch.where(stops[..., None], torch.zeros_like(velocity), velocity)

    def _startled(self, crowd: CrowdState, robot: VisibleRobot) -> Bool[Tensor, "*b h"]:
        """Who is near and ahead of a moving robot."""
        offset = crowd.position - robot.position[..., None, :]
        gap = length(offset) - crowd.radius - robot.radius[..., None]
        bearing = torch.atan2(offset[..., 1], offset[..., 0])
        course = torch.atan2(robot.velocity[..., 1], robot.velocity[..., 0])[..., None]
        ahead = wrap_angle(bearing - course).abs() < 0.5 * math.radians(self.view_deg)
        moving = length(robot.velocity)[..., None] > SLOW_MPS
        return (gap < self.near_m) & ahead & moving

    def _onto_the_line(self, crowd: CrowdState, robot: VisibleRobot) -> Float[Tensor, "*b h 2"]:
        """The shortest way onto the line on which the robot drives, in m/s; nobody goes beyond."""
        speed = length(robot.velocity).clamp_min(SLOW_MPS)[..., None]
        course = (robot.velocity / speed)[..., None, :]
        offset = robot.position[..., None, :] - crowd.position
        across = offset - (offset * course).sum(-1, keepdim=True) * course
        return self.speed_mps * across / length(across)[..., None].clamp_min(1.0)
