"""Where a vehicle crosses a recorded crowd: through a busy place, across the flow."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.planning import disc_radius
from diffstack_mmv.types import RecordedScene

WALKING_MPS = 0.4
"""Who is faster takes part in the flow."""
FASTEST_MPS = 12.0
"""A recorded step that is faster is an error of the recording, not a motion."""
BUSY_M = 2.0
"""Others within this distance make a place busy."""
FLOW_M = 4.0
"""The direction of the flow is that of the agents within this distance."""


class RecordedRows(NamedTuple):
    """Recorded agents at the times of the world's steps; who is never there is left out."""

    position: Float[np.ndarray, "agents rows 2"]  # m
    inside: Bool[np.ndarray, "agents rows"]  # recorded in this row and in the one before
    radius: Float[np.ndarray, " agents"]  # m, of the disc with the area of the box

    def of(self, chosen: Int[np.ndarray, " k"] | Bool[np.ndarray, " agents"]) -> "RecordedRows":
        """Some of the agents."""
        return RecordedRows(self.position[chosen], self.inside[chosen], self.radius[chosen])

    def later(self, first: int, end: int | None = None) -> "RecordedRows":
        """Some of the rows."""
        return RecordedRows(self.position[:, first:end], self.inside[:, first:end], self.radius)


def rows_of(scene: RecordedScene, time_s: Float[np.ndarray, " T"]) -> RecordedRows:
    """Agents at equally distant times in s; between two recorded rows they move straight.

    Args:
        scene: The recording.
        time_s: Times since its start.

    Returns:
        Positions; nobody is inside before and after the recording.
    """
    radius = disc_radius(scene.tracks.extent).numpy()
    place = time_s / scene.dt_s
    lower = np.floor(place + 1e-9).astype(int)
    share = np.clip(place - lower, 0, 1)
    upper = np.where(share > 1e-9, lower + 1, lower)
    steps = scene.tracks.valid.shape[1]
    within = (lower >= 0) & (upper < steps)
    lower, upper = (np.clip(each, 0, steps - 1) for each in (lower, upper))
    there = scene.tracks.valid[:, lower[0] : upper[-1] + 1].any(-1).numpy()
    position = scene.tracks.motion.position[there].numpy()
    valid = scene.tracks.valid[there].numpy()
    between = position[:, lower] + share[:, None] * (position[:, upper] - position[:, lower])
    known = valid[:, lower] & valid[:, upper] & within
    step = np.linalg.norm(np.diff(between, axis=1), axis=-1)
    smooth = step < FASTEST_MPS * (time_s[1] - time_s[0])
    inside = np.zeros_like(known)
    inside[:, 1:] = known[:, 1:] & known[:, :-1] & smooth
    return RecordedRows(between, inside, radius[there])


class Crossing(NamedTuple):
    """A way through a recording."""

    centre: Float[np.ndarray, " 2"]  # m
    heading: float  # rad

    def seen_from(self, position: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 2"]:
        """Positions in m in the frame whose y axis is the way, through the origin."""
        angle = np.pi / 2 - self.heading
        cos, sin = np.cos(angle), np.sin(angle)
        return (position - self.centre) @ np.array([[cos, sin], [-sin, cos]])


@dataclass(frozen=True)
class CrossingRules:
    """How a crossing is drawn.

    Attributes:
        from_s: The place is busy from this time after the start on ...
        until_s: ... until this time.
        turn_deg: The way is at most so far from the right angle to the flow.

    Raises:
        ValueError: A number is negative, or the times are not in order.
    """

    from_s: float = 1.0
    until_s: float = 6.0
    turn_deg: float = 20.0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_at_least("from_s", self.from_s, 0)
        require_positive("until_s - from_s", self.until_s - self.from_s)
        require_at_least("turn_deg", self.turn_deg, 0)

    def draw(
        self, rows: RecordedRows, start: int, step_s: float, random: np.random.RandomState
    ) -> Crossing | None:
        """A crossing through a place with many agents, the more of them the likelier.

        Args:
            rows: The agents; rows beyond the last one count for nothing.
            start: Row in which the vehicle starts.
            step_s: From one row to the next.
            random: Generator, which is advanced.

        Returns:
            The crossing, or None where nobody walks.
        """
        first, last = (start + round(time / step_s) for time in (self.from_s, self.until_s))
        last = min(last, rows.inside.shape[1])  # episodes may end before `until_s`
        now = slice(first, last, 2)
        inside = rows.inside[:, now]
        place = rows.position[:, now][inside]
        before = rows.position[:, first - 1 : last - 1 : 2][inside]
        velocity = (place - before) / step_s
        walks = np.linalg.norm(velocity, axis=-1) > WALKING_MPS
        if walks.sum() < 2:
            return None
        apart = np.linalg.norm(place[walks, None] - place, axis=-1)
        crowd = (apart < BUSY_M).sum(-1).astype(float)
        chosen = random.choice(len(crowd), p=crowd / crowd.sum())
        centre = place[walks][chosen]
        near = apart[chosen] < FLOW_M
        flow = velocity[near].T @ velocity[near]
        axis = np.linalg.eigh(flow)[1][:, -1]
        turn = np.deg2rad(self.turn_deg) * (2 * random.random_sample() - 1)
        side = np.pi / 2 if random.random_sample() < 0.5 else -np.pi / 2
        return Crossing(centre, float(np.arctan2(axis[1], axis[0]) + side + turn))
