"""The crossings of the CrowdNav benchmark: everybody gets a free place, one after the other.

The draws and their order are those of the benchmark.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.simulation.pedestrians import CrowdState
from diffstack_mmv.simulation.placement import first_accepted
from diffstack_mmv.simulation.scenario import MAX_TRIES, Scenario
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.vacancy import Region, Taken, may_have_place

FULLEST = 0.75
"""Share of a region that discs never cover which are placed in it at random, one after the other.

A line jams at 0.75 (Rényi 1958), a plane at 0.55. Nobody has to draw millions of times for it.
"""


class _Placed(NamedTuple):
    """Discs that a newcomer has to keep clear of: the robot and the pedestrians placed so far."""

    position: np.ndarray
    goal: np.ndarray


class _Ground(NamedTuple):
    """Where places are drawn."""

    numbers: int  # that a draw takes, in [0, 1)
    places: Callable[[Float[np.ndarray, "k n"]], Float[np.ndarray, "k 2"]]  # m, of draws
    meets: Region
    extent_m: float  # half the side of a square about the origin that holds it


@dataclass(frozen=True)
class Crossing(Scenario):
    """The robot crosses from (0, -R) to (0, R), and the pedestrians get in its way.

    Pedestrian after pedestrian, start and goal are drawn until they keep clear of the robot and of
    those placed before.

    Raises:
        ValueError: As in `Scenario`.

    Source:
        Chen et al., Crowd-Robot Interaction (ICRA 2019).
    """

    def sample(self, random: np.random.RandomState) -> Scene:
        """Draw a scene, pedestrian by pedestrian; see `Scenario`."""
        radius = self.circle_radius_m
        position, goal = np.zeros((2, self.humans + 1, 2))
        position[0], goal[0] = (0, -radius), (0, radius)
        for pedestrian in range(1, self.humans + 1):
            placed = _Placed(position[:pedestrian], goal[:pedestrian])
            position[pedestrian], goal[pedestrian] = self._place(placed, random)
        return self._scene(torch.from_numpy(position), torch.from_numpy(goal))

    def _scene(self, position: Float[Tensor, "a 2"], goal: Float[Tensor, "a 2"]) -> Scene:
        """Turn positions and goals in m, the robot's first, into a scene."""
        each = position.new_full((self.humans,), 1.0)
        return Scene(
            robot_position=position[0],
            robot_heading=position.new_tensor(np.pi / 2),
            robot_goal=goal[0],
            pedestrians=CrowdState(
                position=position[1:],
                velocity=torch.zeros_like(position[1:]),
                goal=goal[1:],
                radius=each * self.pedestrian_radius_m,
                preferred_speed=each * self.pedestrian_speed_mps,
            ),
        )

    @abstractmethod
    def _place(
        self, placed: _Placed, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw position and goal in m of the next pedestrian."""

    def _first_free(
        self, random: np.random.RandomState, ground: _Ground, taken: Taken, pedestrian: int
    ) -> Float[np.ndarray, "2"]:
        """The first place in m that is drawn on a ground and not taken, for a pedestrian.

        Raises:
            ValueError: None is.
        """
        draw = first_accepted(
            random,
            ground.numbers,
            lambda draws: taken.room(ground.places(draws)) >= 0,
            MAX_TRIES,
            lambda: may_have_place(ground.meets, taken, ground.extent_m),
        )
        if draw is None:
            raise ValueError(self._too_crowded(pedestrian))
        return ground.places(draw[None])[0]

    def _taken(self, others: Float[np.ndarray, "n 2"]) -> Taken:
        """Where no pedestrian can be placed beside the robot, the first, and others, all in m."""
        radii = np.full(len(others), self.pedestrian_radius_m)
        radii[0] = self.robot_radius_m
        return Taken(others, self.pedestrian_radius_m + radii + self.clearance_m)

    @property
    def _half_gap_m(self) -> float:
        """Half of the smallest distance between two pedestrians at the start."""
        return self.pedestrian_radius_m + self.clearance_m / 2

    def _require_room(self, area_m2: float, places: int = 1) -> None:
        """Refuse more pedestrians than ever find a place, without a search.

        Args:
            area_m2: Of all discs of half the smallest distance around where they may start.
            places: That each of them takes: two where the goal is kept free as well.

        Raises:
            ValueError: There are more.
        """
        share = FULLEST * area_m2 / (math.pi * self._half_gap_m**2)
        most = int((share + 2) / places)  # a small region holds more, by its edge
        wanted = f"fit into the scenario, in which at most {most} find a place"
        require(self.humans <= most, "humans", wanted, self.humans, "", self._remedy(most))


@dataclass(frozen=True)
class CircleCrossing(Crossing):
    """Pedestrians start near a circle of radius R and walk to the opposite point.

    Raises:
        ValueError: As in `Scenario`, or there is no room for so many.
    """

    def __post_init__(self) -> None:
        """Check the sizes once, at the border; starts and goals share a ring."""
        super().__post_init__()
        aside = math.sqrt(0.5) * self.pedestrian_speed_mps
        inner, outer = self.circle_radius_m - aside, self.circle_radius_m + aside
        half = self._half_gap_m
        area = math.pi * ((outer + half) ** 2 - max(inner - half, 0) ** 2)
        self._require_room(area, places=2)

    def _place(
        self, placed: _Placed, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw an angle and a displacement until the place is free."""
        taken = self._taken(placed.position).and_of(self._taken(placed.goal))
        extent = self.circle_radius_m + self.pedestrian_speed_mps / 2
        ground = _Ground(3, self._starts, self._meets_starts, extent)
        start = self._first_free(random, ground, taken, len(placed.position))
        return start, -start

    def _starts(self, draws: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
        """Places in m of an angle and a displacement, drawn from [0, 1)."""
        angle = draws[:, 0] * np.pi * 2
        shift = (draws[:, 1:] - 0.5) * self.pedestrian_speed_mps
        return self.circle_radius_m * np.stack([np.cos(angle), np.sin(angle)], -1) + shift

    def _meets_starts(
        self, centers: Float[np.ndarray, "k 2"], half_m: float
    ) -> Bool[np.ndarray, " k"]:
        """Which squares have a place in them that can be drawn: the circle comes near enough."""
        aside = half_m + self.pedestrian_speed_mps / 2
        far, near = abs(centers) + aside, np.maximum(abs(centers) - aside, 0)
        radius = self.circle_radius_m
        return (np.hypot(*near.T) <= radius) & (radius <= np.hypot(*far.T))


@dataclass(frozen=True)
class SquareCrossing(Crossing):
    """Pedestrians start in one half of a square and walk to a point in the other one.

    Attributes:
        square_width_m: Width of the square.

    Raises:
        ValueError: As in `Scenario`, or there is no room for so many.
    """

    square_width_m: float = 10.0
    _sized_by: ClassVar[str] = "square_width_m"

    def __post_init__(self) -> None:
        """Check the sizes once, at the border."""
        super().__post_init__()
        require_positive("square_width_m", self.square_width_m)
        self._require_room((self.square_width_m + 2 * self._half_gap_m) ** 2)

    def _place(
        self, placed: _Placed, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw a side, then a free place on it, then a free goal on the other side."""
        side = -1 if random.random_sample() > 0.5 else 1
        start = self._free_place(placed.position, side, random)
        return start, self._free_place(placed.goal, -side, random)

    def _free_place(
        self, others: np.ndarray, side: int, random: np.random.RandomState
    ) -> np.ndarray:
        """Draw a free place in m in the half with this sign of x."""
        width = self.square_width_m

        def meets(centers: Float[np.ndarray, "k 2"], half_m: float) -> Bool[np.ndarray, " k"]:
            x, y = centers[:, 0] * side, centers[:, 1]
            return (x + half_m >= 0) & (x - half_m <= width / 2) & (abs(y) - half_m <= width / 2)

        ground = _Ground(2, lambda draws: self._places(draws, side), meets, width / 2)
        return self._first_free(random, ground, self._taken(others), len(others))

    def _places(self, draws: Float[np.ndarray, "k 2"], side: int) -> Float[np.ndarray, "k 2"]:
        """Places in m in one half of the square, drawn from [0, 1)."""
        x = draws[:, 0] * self.square_width_m * 0.5 * side
        return np.stack([x, (draws[:, 1] - 0.5) * self.square_width_m], -1)


SCENARIOS: dict[str, type[Scenario]] = {
    "circle_crossing": CircleCrossing,
    "square_crossing": SquareCrossing,
}
