"""What learned policies are shown of an observation, as arrays."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from gymnasium import spaces
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.geometry import length, rotate
from diffstack_mmv.simulation.observation import Observation

FAR = 1e4
"""Bound of all observed numbers, which no vehicle reaches within a time limit."""


@runtime_checkable
class View(Protocol):
    """Turns observations into arrays of a fixed shape."""

    def space(self, pedestrians: int) -> spaces.Space[Any]:
        """Space of the arrays of one episode among so many pedestrians."""
        ...

    def __call__(self, observation: Observation) -> Any:
        """The arrays of all episodes, `*b`."""
        ...


@dataclass(frozen=True)
class WorldView:
    """Robot and pedestrians in SI units and in the world frame.

    `robot` is x, y, heading, world velocity v_x, v_y, yaw rate, radius, goal x, y; `humans` has one
    row per pedestrian: x, y, v_x, v_y, radius.
    """

    def space(self, pedestrians: int) -> spaces.Dict:
        """A row for the robot, and one for each pedestrian."""
        return spaces.Dict(
            {
                "robot": spaces.Box(-FAR, FAR, (9,), dtype=np.float64),
                "humans": spaces.Box(-FAR, FAR, (pedestrians, 5), dtype=np.float64),
            }
        )

    def __call__(self, observation: Observation) -> dict[str, np.ndarray]:
        """Both arrays in m, rad, m/s."""
        seen = observation
        robot = (
            seen.motion.position,
            seen.motion.heading[..., None],
            seen.velocity,
            seen.motion.yaw_rate[..., None],
            seen.radius[..., None],
            seen.goal,
        )
        pedestrians = (
            seen.pedestrian_position,
            seen.pedestrian_velocity,
            seen.pedestrian_radius[..., None],
        )
        return {"robot": _joined(robot), "humans": _joined(pedestrians)}


@dataclass(frozen=True)
class EgoView:
    """One row of numbers near one, in the frame of the robot, the nearest pedestrians first.

    The robot: place of the goal, distance to it, body velocity, yaw rate, time. Each pedestrian:
    whether it is seen, relative place and velocity, and clearance.

    Attributes:
        nearest: At most so many pedestrians.
        reach_m: Lengths count in units of this.
        speed_mps: Speeds count in units of this.
        limit_s: Times count in units of this.

    Raises:
        ValueError: A number is not positive.
    """

    nearest: int = 5
    reach_m: float = 5.0
    speed_mps: float = 3.0
    limit_s: float = 10.0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_at_least("nearest", self.nearest, 1)
        for name in ("reach_m", "speed_mps", "limit_s"):
            require_positive(name, getattr(self, name))

    def space(self, pedestrians: int) -> spaces.Box:
        """A row of 7 numbers and 6 more for each of the nearest pedestrians."""
        return spaces.Box(-FAR, FAR, (7 + 6 * self.nearest,), dtype=np.float32)

    def __call__(self, observation: Observation) -> Float[np.ndarray, "*b f"]:
        """The rows, dimensionless."""
        seen = observation
        back = -seen.motion.heading
        goal = rotate(seen.goal - seen.motion.position, back)
        own = [
            goal / self.reach_m,
            length(goal)[..., None] / self.reach_m,
            seen.motion.velocity / self.speed_mps,
            seen.motion.yaw_rate[..., None],
            seen.time[..., None] / self.limit_s,
        ]
        rows = self._pedestrians(seen)
        return torch.cat([*own, rows.flatten(-2)], -1).float().numpy()

    def _pedestrians(self, seen: Observation) -> Float[Tensor, "*b n 6"]:
        """The nearest pedestrians; rows of zeros where there are fewer."""
        back = -seen.motion.heading[..., None]
        place = seen.pedestrian_position - seen.motion.position[..., None, :]
        speed = seen.pedestrian_velocity - seen.velocity[..., None, :]
        gap = length(place) - seen.radius[..., None] - seen.pedestrian_radius
        columns = [
            torch.ones_like(gap)[..., None],
            rotate(place, back) / self.reach_m,
            rotate(speed, back) / self.speed_mps,
            gap[..., None] / self.reach_m,
        ]
        rows = torch.where(seen.seen[..., None], torch.cat(columns, -1), 0.0)
        order = torch.where(seen.seen, gap, torch.inf).argsort(dim=-1)[..., : self.nearest]
        rows = rows.take_along_dim(order[..., None], -2)
        missing = self.nearest - rows.shape[-2]
        return torch.nn.functional.pad(rows, (0, 0, 0, missing))


def _joined(columns: tuple[Tensor, ...]) -> np.ndarray:
    """Columns side by side."""
    return torch.cat(columns, dim=-1).double().numpy()
