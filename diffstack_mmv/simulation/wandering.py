"""Crowds whose members walk on to new goals, as those of DS-RNN and CrowdNav++ do."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from diffstack_mmv.checks import require_at_least, require_between, require_positive
from diffstack_mmv.simulation.pedestrians import CrowdState, Itinerary
from diffstack_mmv.simulation.scenario import MAX_TRIES, Scenario
from diffstack_mmv.simulation.scene import Scene

GOALS = 24
"""Goals drawn beforehand for each pedestrian: more than anybody reaches within a limit."""
CHANGES = 12
"""Times at which goals may be given up, at least; each more frequent one has a goal of its own."""
LATEST_S = 60.0
"""Goals may be given up until then, which is later than the limit of any benchmark."""


@dataclass(frozen=True)
class WanderingCrossing(Scenario):
    """Pedestrians start on a circle, cross it, and go on to random points of it.

    The robot starts and ends at random points of a square, some way apart, and faces its goal.
    Radii and speeds are drawn uniformly. New goals are drawn beforehand and so do not keep clear of
    where the others are when they are taken; the original draws them then.

    Attributes:
        arena_m: Half the side of the square in which the robot starts and ends.
        way_min_m: Smallest distance between start and goal of the robot.
        radius_max_m: Largest radius of a pedestrian; the smallest is `pedestrian_radius_m`.
        speed_min_mps: Smallest preferred speed.
        speed_max_mps: Largest preferred speed; nobody hurries faster than 1 m/s to a goal.
        shift_m: Smallest and largest displacement of a start from the circle, in each direction.
        change_every_s: Time between two moments at which pedestrians may give up their goals.
        change_chance: Probability that one does so.

    Raises:
        ValueError: A size is out of range.

    Source:
        Liu et al., Decentralized Structural-RNN for Robot Crowd Navigation (ICRA 2021); Liu et al.,
        Intention Aware Robot Crowd Navigation with Attention-Based Interaction Graph (ICRA 2023);
        the settings are those of their public code.
    """

    arena_m: float = 6.0
    way_min_m: float = 6.0
    radius_max_m: float = 0.3
    speed_min_mps: float = 1.0
    speed_max_mps: float = 1.0
    shift_m: Sequence[float] = (-0.5, 0.5)
    change_every_s: float = 5.0
    change_chance: float = 0.0

    def __post_init__(self) -> None:
        """Check the sizes once, at the border."""
        super().__post_init__()
        require_positive("arena_m", self.arena_m)
        require_between("way_min_m", self.way_min_m, 0, 2 * self.arena_m)
        require_at_least("radius_max_m", self.radius_max_m, self.pedestrian_radius_m)
        require_positive("speed_min_mps", self.speed_min_mps)
        require_at_least("speed_max_mps", self.speed_max_mps, self.speed_min_mps)
        require_positive("change_every_s", self.change_every_s)
        require_between("change_chance", self.change_chance, 0, 1)

    def sample(self, random: np.random.RandomState) -> Scene:
        """Draw a scene; see `Scenario`."""
        robot, aim = self._way(random)
        speed = random.uniform(self.speed_min_mps, self.speed_max_mps, self.humans)
        radius = random.uniform(self.pedestrian_radius_m, self.radius_max_m, self.humans)
        places, sizes = [robot, aim], [self.robot_radius_m, self.robot_radius_m]
        for each in radius:
            places.append(self._start(places, sizes, each, random))
            sizes.append(each)
        position = torch.from_numpy(np.array(places[2:]).reshape(-1, 2))
        way = aim - robot
        return Scene(
            robot_position=torch.from_numpy(robot),
            robot_heading=torch.tensor(np.arctan2(way[1], way[0]), dtype=torch.float64),
            robot_goal=torch.from_numpy(aim),
            pedestrians=CrowdState(
                position=position,
                velocity=torch.zeros_like(position),
                goal=-position,
                radius=torch.from_numpy(radius),
                preferred_speed=torch.from_numpy(speed),
            ),
            itinerary=self._itinerary(speed, random),
        )

    def _way(self, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        """Start and goal of the robot in m."""
        while True:
            ends = random.uniform(-self.arena_m, self.arena_m, (2, 2))
            if np.linalg.norm(ends[1] - ends[0]) >= self.way_min_m:
                return ends[0], ends[1]

    def _start(
        self,
        places: list[np.ndarray],
        sizes: list[float],
        radius: float,
        random: np.random.RandomState,
    ) -> np.ndarray:
        """A start in m that keeps clear of everybody placed so far and of the robot's goal."""
        others, reach = np.array(places), np.array(sizes) + radius + self.clearance_m
        least, most = self.shift_m
        for _ in range(MAX_TRIES):
            angle = random.uniform(0, 2 * np.pi)
            start = self.circle_radius_m * np.array((np.cos(angle), np.sin(angle)))
            start = start + random.uniform(least, most, 2)
            if (np.linalg.norm(others - start, axis=1) >= reach).all():
                return start
        raise ValueError(self._too_crowded(len(places) - 1))

    def _itinerary(self, speed: np.ndarray, random: np.random.RandomState) -> Itinerary:
        """Goals near the circle, and who gives up when."""
        changes = max(CHANGES, math.ceil(LATEST_S / self.change_every_s))
        count = GOALS + changes - CHANGES
        angle = random.uniform(0, 2 * np.pi, (self.humans, count, 1))
        shift = random.uniform(-0.5, 0.5, (self.humans, count, 2)) * speed[:, None, None]
        goals = self.circle_radius_m * np.concatenate([np.cos(angle), np.sin(angle)], -1) + shift
        gives_up = random.uniform(size=(self.humans, changes)) < self.change_chance
        times = self.change_every_s * np.arange(1, changes + 1)
        return Itinerary(
            goals=torch.from_numpy(goals),
            taken=torch.zeros(self.humans, dtype=torch.long),
            gives_up=torch.from_numpy(gives_up),
            times=torch.from_numpy(times),
        )
