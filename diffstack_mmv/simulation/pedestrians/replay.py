"""Agents who move as they were recorded, and those who leave their recorded way near the robot."""

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require_at_least, require_positive
from diffstack_mmv.geometry import length
from diffstack_mmv.simulation.pedestrians.base import CrowdState, VisibleRobot
from diffstack_mmv.simulation.pedestrians.half_planes import Agents, Neighbors
from diffstack_mmv.simulation.pedestrians.orca import OrcaCrowd
from diffstack_mmv.simulation.pedestrians.recorded import RecordedCrowdState
from diffstack_mmv.simulation.pedestrians.social_force import SocialForceCrowd


@dataclass(frozen=True)
class ReplayCrowd:
    """Everybody walks as recorded, whatever the robot does."""

    def __call__(
        self, crowd: RecordedCrowdState, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "*b h 2"]:
        """Velocities in m/s that lead to the recorded positions.

        Args:
            crowd: The crowd with its recording.
            dt_s: Length of the step, that of the recording's rows.
            robot: Is not looked at.

        Returns:
            Velocities in m/s, zero for those who are absent now or after the step.

        Raises:
            ValueError: The crowd has no recording, or rows of another step.
        """
        _require_recorded(crowd, dt_s)
        way = crowd.recorded(1) - crowd.position
        return torch.where(crowd.stays()[..., None], way / dt_s, torch.zeros_like(way))


@dataclass(frozen=True)
class ReactiveReplayCrowd:
    """Everybody walks as recorded, avoids the robot where it is near, and then returns to its way.

    Who is off the recorded way heads for where the recording is `return_s` from now, no faster than
    `hurry` times its recorded speed. Near the robot this is the preferred velocity of the model by
    which the robot is avoided.

    Attributes:
        avoidance: How the robot is avoided.
        near_m: Distance from the robot's outline below which it is avoided.
        return_s: Time after which the way is reached again.
        hurry: Largest speed as a multiple of the preferred one.
        speed_min_mps: Nobody's largest speed is smaller, who stands can step aside.

    Raises:
        ValueError: A number is not positive, or the multiple below 1.
    """

    reactive: ClassVar[bool] = True
    avoidance: OrcaCrowd | SocialForceCrowd = field(
        default_factory=lambda: OrcaCrowd(time_horizon_s=3.0, margin_m=0.1)
    )
    near_m: float = 4.0
    return_s: float = 1.0
    hurry: float = 1.3
    speed_min_mps: float = 0.8

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("near_m", self.near_m)
        require_positive("return_s", self.return_s)
        require_at_least("hurry", self.hurry, 1.0)
        require_positive("speed_min_mps", self.speed_min_mps)

    def __call__(
        self, crowd: RecordedCrowdState, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "*b h 2"]:
        """Velocities in m/s for the next step.

        Args:
            crowd: The crowd with its recording.
            dt_s: Length of the step, that of the recording's rows.
            robot: The robot; without it everybody walks as recorded.

        Returns:
            Velocities in m/s, zero for those who are absent now or after the step.

        Raises:
            ValueError: The crowd has no recording, or rows of another step.
        """
        recorded = ReplayCrowd()(crowd, dt_s)
        if robot is None:
            return recorded
        most = (self.hurry * crowd.preferred_speed).clamp_min(self.speed_min_mps)
        off = length(crowd.recorded(0) - crowd.position) > 1e-6
        wanted = torch.where(off[..., None], self._returning(crowd, most), recorded)
        distance = length(crowd.position - robot.position[..., None, :])
        near = distance - crowd.radius - robot.radius[..., None] < self.near_m
        if not bool(near.any()):
            return torch.where(crowd.stays()[..., None], wanted, torch.zeros_like(wanted))
        avoiding = self._avoiding(crowd, wanted, torch.maximum(most, length(wanted)), robot, dt_s)
        chosen = torch.where(near[..., None], avoiding, wanted)
        return torch.where(crowd.stays()[..., None], chosen, torch.zeros_like(chosen))

    def _returning(
        self, crowd: RecordedCrowdState, most: Float[Tensor, "*b h"]
    ) -> Float[Tensor, "*b h 2"]:
        """Velocity in m/s towards the recorded way, no faster than allowed."""
        step_s = float(crowd.step_s.reshape(-1)[0])
        ahead = max(round(self.return_s / step_s), 1)
        there = torch.where(crowd.inside_after(ahead)[..., None], crowd.recorded(ahead), crowd.goal)
        velocity = (there - crowd.position) / (ahead * step_s)
        speed = length(velocity)
        return velocity * (most / speed.clamp(min=1e-6)).clamp(max=1)[..., None]

    def _avoiding(
        self,
        crowd: RecordedCrowdState,
        wanted: Float[Tensor, "*b h 2"],
        most: Float[Tensor, "*b h"],
        robot: VisibleRobot,
        dt_s: float,
    ) -> Float[Tensor, "*b h 2"]:
        """Velocity in m/s of everybody among the others and the robot."""
        plain = CrowdState(
            crowd.position, crowd.velocity, crowd.position + wanted, crowd.radius, most
        )
        if isinstance(self.avoidance, SocialForceCrowd):
            return self.avoidance(plain, dt_s, robot)
        agents = Agents(crowd.position, crowd.velocity, wanted, crowd.radius, most)
        each = (*crowd.radius.shape, 1)
        # the others are in the recording already, in which everybody kept clear of everybody
        seen = Neighbors(
            position=robot.position[..., None, None, :].expand(*each, 2),
            velocity=robot.velocity[..., None, None, :].expand(*each, 2),
            radius=robot.radius[..., None, None].expand(each),
            valid=torch.ones(each, dtype=torch.bool, device=crowd.radius.device),
        )
        return self.avoidance.velocity(agents, seen, dt_s)


def _require_recorded(crowd: RecordedCrowdState, dt_s: float) -> None:
    """Refuse a crowd without a recording, or with rows of another step in s.

    Raises:
        ValueError: It is one.
    """
    if not isinstance(crowd, RecordedCrowdState):
        remedy = "Choose scenario=replay."
        raise ValueError(message("crowd", "have a recording", type(crowd).__name__, "", remedy))
    step_s = float(crowd.step_s.reshape(-1)[0])
    if abs(step_s - dt_s) > 1e-9:
        remedy = "Give scenario and world the same `dt_s`."
        raise ValueError(message("dt_s", f"be the {step_s:g} s of the recording", dt_s, "", remedy))
