"""Where episodes start, and what gives such starts by number."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.simulation.pedestrians import AnyCrowdState, Itinerary
from diffstack_mmv.types import map_tensors


class Scene(NamedTuple):
    """Start of episodes `*b`, the robot at rest, `h` pedestrians; float64, m, rad, world frame."""

    robot_position: Float[Tensor, "*b 2"]
    robot_heading: Float[Tensor, "*b"]
    robot_goal: Float[Tensor, "*b 2"]
    pedestrians: AnyCrowdState
    itinerary: Itinerary | None = None  # where the pedestrians go after their goals; else they stay
    number: Int[Tensor, "*b"] | None = None  # of the case, to which all draws of noise belong

    def case_numbers(self) -> Int[Tensor, "*b"]:
        """Numbers of the cases, or of the rows where none are given."""
        if self.number is not None:
            return self.number
        rows = self.robot_heading
        return torch.arange(rows.numel(), device=rows.device).reshape(rows.shape)

    def radii_and_goal(self) -> tuple[list[float], list[float]]:
        """Radii of the pedestrians and goal of the robot in m, of one case, to draw it."""
        return self.pedestrians.radius.tolist(), self.robot_goal.tolist()


@runtime_checkable
class CaseSource(Protocol):
    """Gives the start of a case by its number."""

    def cases(self, phase: str, numbers: Iterable[int]) -> Scene:
        """Several cases of a phase as one batch."""
        ...

    def case(self, phase: str, number: int) -> Scene:
        """One case of a phase, without a batch."""
        ...


def stacked(scenes: Sequence[Scene]) -> Scene:
    """Scenes without leading dimensions as a batch.

    Raises:
        ValueError: There are none.
    """
    require(len(scenes) > 0, "numbers", "name at least one case", "none")
    return map_tensors(lambda *entries: torch.stack(entries), *scenes)
