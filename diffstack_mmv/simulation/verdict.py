"""A verdict on a step: what it looks at, and the reward for its outcome."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import length
from diffstack_mmv.simulation.collision import ClosestApproach, Footprint
from diffstack_mmv.simulation.pedestrians import AnyCrowdState
from diffstack_mmv.types import Motion, Outcome


class RobotPath(NamedTuple):
    """Path of the robot's centre over one step, `k` points at equal intervals, ends included."""

    position: Float[Tensor, "*b k 2"]  # m
    heading: Float[Tensor, "*b k"]  # rad


class Encounter(NamedTuple):
    """One step of robot and pedestrians, with all that a verdict may look at."""

    path: RobotPath
    footprint: Footprint  # of the robot
    velocity: Float[Tensor, "*b 2"]  # m/s, of the robot: constant over the step, to the same end
    pedestrians: AnyCrowdState  # before the step
    pedestrian_velocity: Float[Tensor, "*b h 2"]  # m/s, that holds during the step
    goal: Float[Tensor, "*b 2"]  # m
    time: Float[Tensor, "*b"]  # s, before the step
    dt_s: float


class Judgement(NamedTuple):
    """The verdict on one step."""

    outcome: Int[Tensor, "*b"]  # an Outcome
    reward: Float[Tensor, "*b"]
    clearance: Float[Tensor, "*b"]  # m, smallest one over the step


@dataclass(frozen=True)
class Rewards:
    """Rewards of the benchmark, per step.

    Attributes:
        success: For reaching the goal.
        collision: For a collision.
        discomfort_m: Clearance below which a pedestrian feels uncomfortable.
        discomfort_factor: Penalty per metre below that clearance and per second.
    """

    success: float = 1.0
    collision: float = -0.25
    discomfort_m: float = 0.2
    discomfort_factor: float = 0.5

    def of(
        self, outcome: Int[Tensor, "*b"], clearance: Float[Tensor, "*b"], dt_s: float
    ) -> Float[Tensor, "*b"]:
        """Reward of a step of `dt_s` with this outcome and clearance (m)."""
        uneasy = (clearance - self.discomfort_m) * self.discomfort_factor * dt_s
        reward = torch.where(outcome == Outcome.DISCOMFORT, uneasy, torch.zeros_like(uneasy))
        reward = torch.where(outcome == Outcome.COLLISION, self.collision, reward)
        return torch.where(outcome == Outcome.SUCCESS, self.success, reward)


@dataclass(frozen=True)
class Verdict(ABC):
    """Judges the steps of episodes.

    Attributes:
        limit_s: Time limit of an episode.
        goal_tolerance_m: The goal counts as reached where a step ends closer than this to it.
        rewards: What each outcome is worth.

    Raises:
        ValueError: The limit or the tolerance is not positive.

    Source:
        Chen et al., Crowd-Robot Interaction (ICRA 2019), Eq. 2.
    """

    precedence: ClassVar[tuple[Outcome, ...]]
    """Outcomes of a step, each of which hides those before it."""
    limit_s: float
    goal_tolerance_m: float = 0.3
    rewards: Rewards = field(default_factory=Rewards)

    def __post_init__(self) -> None:
        """Check the sizes once, at the border."""
        require_positive("limit_s", self.limit_s)
        require_positive("goal_tolerance_m", self.goal_tolerance_m)

    def __call__(self, step: Encounter) -> Judgement:
        """Judge one step of every episode.

        Args:
            step: The step, `*b`.

        Returns:
            Outcome, reward and smallest clearance in m.
        """
        clearance = _nearest(self._clearance(step), step.pedestrians.present)
        way = step.path.position[..., -1, :] - step.goal
        facts = {
            Outcome.DISCOMFORT: clearance < self.rewards.discomfort_m,
            Outcome.COLLISION: clearance < 0,
            Outcome.SUCCESS: length(way) < self.goal_tolerance_m,
            Outcome.TIMEOUT: self._is_late(step),
        }
        outcome = torch.full_like(clearance, Outcome.RUNNING, dtype=torch.int64)
        for each in self.precedence:
            outcome = torch.where(facts[each], int(each), outcome)
        return Judgement(outcome, self.rewards.of(outcome, clearance, step.dt_s), clearance)

    @abstractmethod
    def _clearance(self, step: Encounter) -> Float[Tensor, "*b h"]:
        """Smallest clearance in m to each pedestrian over the step."""

    @abstractmethod
    def _is_late(self, step: Encounter) -> Bool[Tensor, "*b"]:
        """Whether the time is up at the end of the step."""


def clearance_at_rest(
    motion: Motion, footprint: Footprint, pedestrians: AnyCrowdState
) -> Float[Tensor, "*b"]:
    """Clearance in m from a robot that stands there to the nearest pedestrian, all at rest."""
    offset = pedestrians.position - motion.position[..., None, :]
    heading = motion.heading[..., None].expand(pedestrians.radius.shape)
    approach = ClosestApproach(offset, offset, pedestrians.radius, heading, heading)
    return _nearest(footprint.clearance(approach), pedestrians.present)


def _nearest(
    clearance: Float[Tensor, "*b h"], present: Bool[Tensor, "*b h"]
) -> Float[Tensor, "*b"]:
    """Clearance in m to the nearest of h pedestrians, infinite where there are none."""
    # who is absent is kept at a place of its own, far away, which is no clearance
    apart = torch.where(present, clearance, torch.inf)
    return torch.nn.functional.pad(apart, (0, 1), value=torch.inf).amin(dim=-1)
