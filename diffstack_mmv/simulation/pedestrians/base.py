"""What every pedestrian model gets and gives: the interface behind which models are exchanged."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.geometry import length


class PedestrianHistory(NamedTuple):
    """What was seen of the pedestrians before an episode, oldest row first; zero where absent."""

    position: Float[Tensor, "*b h P 2"]  # m
    velocity: Float[Tensor, "*b h P 2"]  # m/s, over the step that leads to the row
    present: Bool[Tensor, "*b h P"]
    step_s: float  # from one row to the next, and from the last one to the start


class CrowdState(NamedTuple):
    """The pedestrians of a batch of episodes; lengths in m, speeds in m/s, world frame."""

    position: Float[Tensor, "*b h 2"]
    velocity: Float[Tensor, "*b h 2"]
    goal: Float[Tensor, "*b h 2"]
    radius: Float[Tensor, "*b h"]
    preferred_speed: Float[Tensor, "*b h"]

    @property
    def present(self) -> Bool[Tensor, "*b h"]:
        """Who is there now: everybody."""
        return torch.ones_like(self.radius, dtype=torch.bool)

    def history(self) -> PedestrianHistory | None:
        """Nothing was seen of them before the start."""
        return None

    def moved(self, velocity: Float[Tensor, "*b h 2"], dt_s: float) -> "CrowdState":
        """The crowd after `dt_s` at constant `velocity` (m/s)."""
        return self._replace(position=self.position + velocity * dt_s, velocity=velocity)


class Itinerary(NamedTuple):
    """Where pedestrians go after their present goals: drawn beforehand, one after the other.

    Who has come to its goal takes the next one, and at each of M times some give up theirs for the
    next one. The last goal of the list is kept.
    """

    goals: Float[Tensor, "*b h L 2"]  # m
    taken: Int[Tensor, "*b h"]  # how many of them have been taken
    gives_up: Bool[Tensor, "*b h M"]  # whether the goal of then is given up at each of the times
    times: Float[Tensor, "*b M"]  # s

    def followed(
        self, crowd: CrowdState, before: Float[Tensor, "*b"], after: Float[Tensor, "*b"]
    ) -> tuple[CrowdState, "Itinerary"]:
        """The crowd with its goals at a time, and the itinerary from then on.

        Args:
            crowd: The pedestrians at the time `after`, with the goals they had until then.
            before: Time of the step before in s.
            after: Present time in s.
        """
        arrived = length(crowd.goal - crowd.position) < crowd.radius
        due = (self.times > before[..., None]) & (self.times <= after[..., None])
        changes = arrived | (self.gives_up & due[..., None, :]).any(-1)
        last = self.goals.shape[-2] - 1
        index = self.taken.clamp(max=last)[..., None, None]
        following = self.goals.take_along_dim(index, -2).squeeze(-2)
        goal = torch.where(changes[..., None], following, crowd.goal)
        return crowd._replace(goal=goal), self._replace(taken=self.taken + changes.long())


class VisibleRobot(NamedTuple):
    """A robot that the pedestrians see; position in m, velocity in m/s, radius in m."""

    position: Float[Tensor, "*b 2"]
    velocity: Float[Tensor, "*b 2"]
    radius: Float[Tensor, "*b"]


@runtime_checkable
class Crowd(Protocol):
    """A pedestrian model: all pedestrians of all episodes choose their next velocity at once."""

    def __call__(
        self, crowd: Any, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "*b h 2"]:
        """Velocities in m/s that hold for the next `dt_s`, from the present state of everybody.

        The state is the one that the scenario begins with, a `CrowdState` or one with a recording.
        """
        ...


def towards(
    position: Float[Tensor, "*#b 2"], goal: Float[Tensor, "*#b 2"]
) -> Float[Tensor, "*b 2"]:
    """Walk towards the goal at 1 m/s, slowing down within the last metre.

    Args:
        position: Where the agent is, m.
        goal: Where it wants to be, m.

    Returns:
        Velocity in m/s.

    Source:
        Chen et al., Crowd-Robot Interaction: the preferred velocity of the benchmark's humans,
        which disregards their preferred speed.
    """
    way = goal - position
    distance = length(way)[..., None]
    return torch.where(distance > 1, way / distance, way)
