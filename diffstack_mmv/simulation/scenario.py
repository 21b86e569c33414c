"""Initial states of episodes: a case is a number, and the same number always gives the same case.

A case is drawn from a generator of its own; the global generator of numpy is left alone.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch

from diffstack_mmv.checks import message, require_at_least, require_positive, require_whole
from diffstack_mmv.simulation.phases import generator
from diffstack_mmv.simulation.scene import Scene, stacked

MAX_TRIES = 20_000_000
"""Draws for one pedestrian before a scenario counts as too crowded; the benchmark never stops."""


@dataclass(frozen=True)
class Scenario(ABC):
    """A family of cases: where robot and pedestrians start, and where they want to go.

    Attributes:
        humans: Number of pedestrians, by the word of the benchmark.
        circle_radius_m: R, of the circle around the origin that is crossed.
        pedestrian_radius_m: Radius of each pedestrian.
        pedestrian_speed_mps: Preferred speed of each pedestrian.
        robot_radius_m: Radius of the robot that the placement keeps clear of.
        clearance_m: Smallest clearance between any two agents at the start.

    Raises:
        ValueError: A size is out of range.
    """

    humans: int = 5
    circle_radius_m: float = 4.0
    pedestrian_radius_m: float = 0.3
    pedestrian_speed_mps: float = 1.0
    robot_radius_m: float = 0.3
    clearance_m: float = 0.2
    _sized_by: ClassVar[str] = "circle_radius_m"

    def __post_init__(self) -> None:
        """Check the sizes once, at the border."""
        require_whole("humans", self.humans)
        require_at_least("humans", self.humans, 0)
        require_positive("circle_radius_m", self.circle_radius_m)
        require_positive("pedestrian_radius_m", self.pedestrian_radius_m)
        require_positive("pedestrian_speed_mps", self.pedestrian_speed_mps)
        require_positive("robot_radius_m", self.robot_radius_m)
        require_at_least("clearance_m", self.clearance_m, 0)

    def case(self, phase: str, number: int) -> Scene:
        """One case without leading dimensions.

        Args:
            phase: "train", "val" or "test".
            number: Which case of the phase, from 0.

        Returns:
            The scene, in m and rad.

        Raises:
            ValueError: There is no such phase or case, or the scenario is too crowded.
        """
        try:
            scene = self.sample(generator(phase, number))
        except ValueError as error:
            raise ValueError(f"{error} This was case {number} of phase {phase!r}.") from error
        return scene._replace(number=torch.tensor(number))

    def cases(self, phase: str, numbers: Iterable[int]) -> Scene:
        """Several cases as one batch.

        Args:
            phase: "train", "val" or "test".
            numbers: The cases of the phase.

        Returns:
            The scenes with one leading dimension, in m and rad.

        Raises:
            ValueError: As in `case`, or there are no numbers.
        """
        return stacked([self.case(phase, number) for number in numbers])

    @abstractmethod
    def sample(self, random: np.random.RandomState) -> Scene:
        """Draw a scene.

        Args:
            random: Generator, which is advanced.

        Returns:
            A scene without leading dimensions, in m and rad.

        Raises:
            ValueError: No free place was found for a pedestrian.
        """

    def _too_crowded(self, pedestrian: int) -> str:
        """Explain that the scenario has no room for one more pedestrian."""
        wanted = f"fit into the scenario, which has no place for pedestrian {pedestrian}"
        return message("humans", wanted, self.humans, remedy=self._remedy(pedestrian - 1))

    def _remedy(self, most: int) -> str:
        size = f"scenario.{self._sized_by} than {getattr(self, self._sized_by):g}"
        return f"Take scenario.humans={max(most, 1)} at most, or a larger {size}."
