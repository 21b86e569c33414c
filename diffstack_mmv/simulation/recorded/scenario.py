"""Cases in recorded crowds: a case is a number, and the same number gives the same case."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import torch

from diffstack_mmv.checks import (
    message,
    require,
    require_at_least,
    require_multiple,
    require_positive,
    require_whole,
)
from diffstack_mmv.simulation.phases import generator
from diffstack_mmv.simulation.recorded.blind_drive import BlindDrive
from diffstack_mmv.simulation.recorded.case_scene import USUAL_RADIUS_M, case_scene
from diffstack_mmv.simulation.recorded.crossing import CrossingRules, RecordedRows, rows_of
from diffstack_mmv.simulation.recorded.passage import PassageRules, Walks
from diffstack_mmv.simulation.scene import Scene, stacked
from diffstack_mmv.types import RecordedScene

MAX_TRIES = 2000
"""Draws for one case before a recording counts as too empty or too full."""
NEAR_WAY_M = 2.0
"""Who comes closer to the way is met."""


@runtime_checkable
class SceneReader(Protocol):
    """Gives whole recorded scenes."""

    def duration_s(self, split: str) -> dict[str, float]:
        """Length in s of every scene of a split, by its name."""
        ...

    def read(self, name: str) -> RecordedScene:
        """Everybody in a scene."""
        ...


@dataclass(frozen=True)
class RecordedCrossing:
    """A vehicle crosses the flow of a recorded crowd through a busy place.

    The phases are the splits of the recordings. A case is drawn from the seed of its number: a
    recording (the longer, the likelier), a time, a place and a direction. It is taken if the start
    is free, some agents are met, a straight drive hits somebody, nobody's track begins beside the
    way while the vehicle is on it, and the way is passable for somebody who knows where they will
    be; otherwise the draw is repeated. The scene is turned so that the vehicle starts at
    (0, -way / 2) and its goal lies at (0, way / 2). Nothing of a recording is stored.

    Attributes:
        recordings: Where the scenes come from.
        way_m: Length of the way.
        humans: At most so many agents, those that come nearest to the way.
        met: Smallest number of agents that come within 2 m of the way within `least_s`.
        blind_mps: Who drives straight on at this speed from rest, at the acceleration of `passage`,
            hits somebody: there is something to avoid. 0 takes all cases.
        entry_m: Nobody's track begins nearer to the way than this within `cover_s`.
        reach_m: Who never comes nearer to the way is left out.
        dt_s: Step of the world.
        history_s: What is seen before the start; no case starts earlier in a recording.
        cover_s: A recording goes on for so long after the start, if it is long enough, ...
        least_s: ... and for so long at least.
        limit_s: What is kept of it, the time limit of the episodes.
        robot_radius_m: Radius of the vehicle that the placement keeps clear of.
        clearance_m: Smallest clearance of the vehicle in the first half second.
        crossing: How place and direction are drawn.
        passage: How it is decided whether the way is passable.

    Raises:
        ValueError: A number is out of range.
    """

    recordings: SceneReader
    way_m: float = 14.0
    humans: int = 24
    met: int = 3
    blind_mps: float = 3.0
    entry_m: float = 4.0
    reach_m: float = 10.0
    dt_s: float = 0.25
    history_s: float = 4.0
    cover_s: float = 12.0
    least_s: float = 6.0
    limit_s: float = 20.0
    robot_radius_m: float = 0.3
    clearance_m: float = 0.3
    crossing: CrossingRules = field(default_factory=CrossingRules)
    passage: PassageRules = field(default_factory=PassageRules)
    _known: dict[tuple[str, int], Scene] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("way_m", "reach_m", "dt_s", "least_s", "robot_radius_m"):
            require_positive(name, getattr(self, name))
        require_whole("humans", self.humans)
        require_at_least("humans", self.humans, 1)
        require_at_least("met", self.met, 0)
        require_at_least("blind_mps", self.blind_mps, 0)
        require_at_least("entry_m", self.entry_m, 0)
        require_at_least("clearance_m", self.clearance_m, 0)
        require_at_least("cover_s", self.cover_s, self.least_s)
        require_multiple("history_s", self.history_s, self.dt_s, "for the step `dt_s`")
        require_multiple("limit_s", self.limit_s, self.dt_s, "for the step `dt_s`")

    @property
    def circle_radius_m(self) -> float:
        """Half of the way, as the scenarios of the benchmark call it."""
        return self.way_m / 2

    @property
    def pedestrian_radius_m(self) -> float:
        """Radius of a pedestrian in a picture; everybody has one of its own."""
        return USUAL_RADIUS_M

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
        return stacked([self._remembered(phase, number) for number in numbers])

    def _remembered(self, phase: str, number: int) -> Scene:
        """A case, which is drawn once: every controller of a study drives it."""
        if (phase, number) not in self._known:
            self._known[phase, number] = self.case(phase, number)
        return self._known[phase, number]

    def case(self, phase: str, number: int) -> Scene:
        """One case without leading dimensions.

        Args:
            phase: "train", "val" or "test".
            number: Which case of the phase, from 0.

        Returns:
            The scene, in m and rad.

        Raises:
            ValueError: There is no such phase or case, no recording is long enough, or none has
                such a crossing.
        """
        random = generator(phase, number)
        names, longest = self._long_enough(phase)
        weight = np.array([longest[name] - self.history_s for name in names])
        for _ in range(MAX_TRIES):
            name = names[random.choice(len(names), p=weight / weight.sum())]
            scene = self._drawn(self.recordings.read(name), longest[name], random)
            if scene is not None:
                return scene._replace(number=torch.tensor(number))
        wanted = f"leave a passable crossing with {self.met} agents in {MAX_TRIES} draws"
        remedy = "Lower it (scenario.met=0), or raise `limit_s`: the way takes its time."
        raise ValueError(message("met", wanted, self.met, f"in '{phase}'", remedy))

    def _long_enough(self, phase: str) -> tuple[list[str], dict[str, float]]:
        """Names and lengths in s of the recordings in which a case fits."""
        longest = self.recordings.duration_s(phase)
        least_s = self.history_s + self.least_s
        names = sorted(name for name, length_s in longest.items() if length_s >= least_s)
        told = f"at most {max(longest.values()):.1f} s"
        remedy = "Lower `history_s` or `least_s`."
        require(bool(names), "least_s", f"leave recordings of {least_s:g} s", told, "", remedy)
        return names, longest

    def _drawn(
        self, recorded: RecordedScene, length_s: float, random: np.random.RandomState
    ) -> Scene | None:
        """Draw a time, a place and a direction; None where that is no case."""
        latest = max(length_s - self.cover_s, self.history_s)
        start_s = self.history_s + random.random_sample() * (latest - self.history_s)
        start_s = round(start_s / recorded.dt_s) * recorded.dt_s
        lead = round(self.history_s / self.dt_s)
        steps = np.arange(-lead, round(self.limit_s / self.dt_s) + 1)
        rows = rows_of(recorded, start_s + self.dt_s * steps)
        crossing = self.crossing.draw(rows, lead, self.dt_s, random)
        if crossing is None:
            return None
        seen = rows._replace(position=crossing.seen_from(rows.position))
        seen = seen.of(self._nearest(seen.later(lead)))
        if not self._is_case(seen.later(lead)):
            return None
        return case_scene(seen, lead, self.dt_s, self.way_m, self.humans)

    def _nearest(self, rows: RecordedRows) -> np.ndarray:
        """Numbers of the agents that come nearest to the way, no more than there is room for."""
        apart = self._from_way(rows).min(-1, initial=np.inf)
        order = np.argsort(apart, kind="stable")[: self.humans]
        return order[apart[order] < self.reach_m]

    def _from_way(self, rows: RecordedRows) -> np.ndarray:
        """Distance from the way in m, (agents, rows); infinite for those who are absent."""
        beyond = np.maximum(np.abs(rows.position[..., 1]) - self.way_m / 2, 0)
        apart = np.hypot(rows.position[..., 0], beyond)
        return np.where(rows.inside, apart, np.inf)

    def _is_case(self, rows: RecordedRows) -> bool:
        """Whether agents are in the way, nobody appears, and there is a way past them."""
        soon = round(self.least_s / self.dt_s)
        way = self._from_way(rows.later(0, soon))
        if int((way.min(-1, initial=np.inf) < NEAR_WAY_M).sum()) < self.met:
            return False
        if self._somebody_appears(rows):
            return False
        walks = Walks(rows.position, rows.inside, rows.radius, self.dt_s)
        blind = BlindDrive(self.blind_mps, self.passage.acceleration_mps2, self.way_m)
        if self.blind_mps and not blind.hits(walks, self.robot_radius_m):
            return False
        at_start = round(0.5 / self.dt_s) + 1
        start = np.array([[0.0, -self.way_m / 2]])
        free = walks.free(start, self.robot_radius_m + self.clearance_m)
        if not free[:at_start].all():
            return False
        return self.passage.passable(walks, self.way_m, self.robot_radius_m)

    def _somebody_appears(self, rows: RecordedRows) -> bool:
        """Whether a track begins beside the way after the start: nobody could know of it."""
        covered = rows.later(0, round(self.cover_s / self.dt_s))
        entered = ~covered.inside[:, :-1] & covered.inside[:, 1:]
        return bool((self._from_way(covered)[:, 1:][entered] < self.entry_m).any())
