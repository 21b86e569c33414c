"""Simulated road users: they follow their route, each other and the lights, and give way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_converters.imptc.sample.lights import GREEN, RED_YELLOW, YELLOW, SignalPlan
from data_converters.imptc.sample.routes import SPACING_M, Route

Array = NDArray[np.float64]

STEP_S = 0.04
LOOK_M = np.arange(1.0, 21.0, 1.5)
GAP_M = 1.2
HEADWAY_S = 0.8
COMFORT_MPS2 = 1.5
FREE_M = 1e3


@dataclass(frozen=True)
class Traveller:
    """One road user to be simulated.

    Attributes:
        class_id: IMPTC class.
        route: Where it goes; its end is the goal.
        speed_mps: Speed it likes to travel at.
        acceleration_mps2: Acceleration it likes.
        extent_m: Length, width, height.
        start_s: Time it appears.
        start_m: Arc length where it appears.
        wander: Amplitude in m, period in s and phase in rad of its lateral wandering.
    """

    class_id: int
    route: Route
    speed_mps: float
    acceleration_mps2: float
    extent_m: tuple[float, float, float]
    start_s: float
    start_m: float
    wander: tuple[float, float, float]


class TrafficMotion(NamedTuple):
    """True motion: step numbers (n,), position (n, 2) m, heading (n,) rad, speed (n,) m/s."""

    step: NDArray[np.int64]
    position: Array
    heading: Array
    speed: Array


class _World:
    """State of all travellers, and their routes padded to one length."""

    def __init__(self, travellers: list[Traveller]) -> None:
        length = max(len(t.route.points) for t in travellers)
        self.points = np.stack([_padded(t.route.points, length) for t in travellers])
        self.headings = np.stack([_padded(t.route.heading, length) for t in travellers])
        self.limits = np.stack([_padded(t.route.speed_limit, length) for t in travellers])
        self.goal = np.array([t.route.length_m for t in travellers])
        self.stop = np.array([t.route.stop_m for t in travellers])
        self.arm = np.array([t.route.arm for t in travellers])
        self.liked = np.array([t.speed_mps for t in travellers])
        self.pull = np.array([t.acceleration_mps2 for t in travellers])
        self.length = np.array([t.extent_m[0] for t in travellers])
        self.radius = np.array([0.5 * max(t.extent_m[1], 0.6) for t in travellers])
        self.start = np.array([t.start_s for t in travellers])
        self.wander = np.array([t.wander for t in travellers])
        self.arc = np.array([t.start_m for t in travellers])
        self.speed = 0.8 * np.minimum(self.liked, self.limit())
        self.side = np.zeros(len(travellers))
        self.side_speed = np.zeros(len(travellers))
        self.active = np.zeros(len(travellers), dtype=bool)
        self.done = np.zeros(len(travellers), dtype=bool)

    def index(self, arc: Array) -> NDArray[np.int64]:
        return np.clip((arc / SPACING_M).astype(np.int64), 0, self.points.shape[1] - 2)

    def limit(self) -> Array:
        return self.limits[np.arange(len(self.arc)), self.index(self.arc)]

    def heading(self) -> Array:
        return self.headings[np.arange(len(self.arc)), self.index(self.arc)]

    def position(self, arc: Array, side: Array) -> Array:
        """Points (n, 2) or (n, m, 2) m at arc lengths (n,) or (n, m), `side` m to the left."""
        row = np.arange(len(arc)).reshape(-1, *[1] * (arc.ndim - 1))
        index = self.index(arc)
        share = np.clip(arc / SPACING_M - index, 0.0, 1.0)[..., None]
        point = self.points[row, index] * (1.0 - share) + self.points[row, index + 1] * share
        heading = self.headings[row, index]
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return point + left * side[..., None]


def _padded(values: Array, length: int) -> Array:
    return np.concatenate([values, np.repeat(values[-1:], length - len(values), axis=0)])


def simulate(
    travellers: list[Traveller], plan: SignalPlan, duration_s: float
) -> list[TrafficMotion]:
    """Move all travellers by the intelligent driver model in steps of 0.04 s.

    Source: Treiber, Hennecke, Helbing, "Congested traffic states", Phys. Rev. E 62 (2000), for the
    acceleration; lateral avoidance and right of way are simple rules of ours.

    Args:
        travellers: Who travels; earlier ones have the right of way where paths cross.
        plan: The lights.
        duration_s: How long, in s.

    Returns:
        One `TrafficMotion` per traveller, possibly with no steps.
    """
    world = _World(travellers)
    log: list[list[tuple[int, float, float, float, float]]] = [[] for _ in travellers]
    for step in range(round(duration_s / STEP_S)):
        time_s = step * STEP_S
        _admit(world, time_s)
        _advance(world, plan, time_s)
        here = world.position(world.arc, world.side)
        lean_in = np.arctan2(world.side_speed, np.maximum(world.speed, 0.5))
        heading = world.heading() + lean_in
        for i in np.flatnonzero(world.active):
            log[i].append((step, here[i, 0], here[i, 1], heading[i], world.speed[i]))
    return [_motion(entries) for entries in log]


def _motion(entries: list[tuple[int, float, float, float, float]]) -> TrafficMotion:
    table = np.array(entries, dtype=np.float64).reshape(-1, 5)
    return TrafficMotion(table[:, 0].astype(np.int64), table[:, 1:3], table[:, 3], table[:, 4])


def _admit(world: _World, time_s: float) -> None:
    """Let in who is due and finds 4 m of room; take out who has reached the goal."""
    world.done |= world.active & (world.arc >= world.goal - 0.5)
    world.active &= ~world.done
    here = world.position(world.arc, world.side)
    for i in np.flatnonzero(~world.active & ~world.done & (world.start <= time_s)):
        others = here[world.active]
        if len(others) == 0 or np.linalg.norm(others - here[i], axis=1).min() > 4.0:
            world.active[i] = True


def _advance(world: _World, plan: SignalPlan, time_s: float) -> None:
    here = world.position(world.arc, world.side)
    gap, closing, push = _conflicts(world, here)
    light_gap = _gap_to_red(world, plan, time_s)
    stops = light_gap < gap
    gap, closing = np.where(stops, light_gap, gap), np.where(stops, world.speed, closing)
    room = world.speed * closing / (2.0 * np.sqrt(world.pull * COMFORT_MPS2))
    wanted = GAP_M + np.maximum(0.0, world.speed * HEADWAY_S + room)
    free = (world.speed / np.minimum(world.liked, world.limit())) ** 4
    acceleration = world.pull * (1.0 - free - (wanted / np.maximum(gap, 0.3)) ** 2)
    acceleration = np.clip(acceleration, -4.0, world.pull)
    speed = np.maximum(world.speed + acceleration * STEP_S, 0.0)
    amplitude, period, phase = world.wander.T
    target = amplitude * np.sin(2.0 * np.pi * time_s / period + phase)
    pull = 1.5 * (target + push - world.side) - 2.2 * world.side_speed
    side_speed = (world.side_speed + pull * STEP_S) * np.minimum(1.0, speed / 0.5)
    moving = world.active
    world.arc = np.where(moving, world.arc + 0.5 * (world.speed + speed) * STEP_S, world.arc)
    world.speed = np.where(moving, speed, world.speed)
    world.side_speed = np.where(moving, side_speed, 0.0)
    world.side = np.where(moving, world.side + side_speed * STEP_S, world.side)


def _conflicts(world: _World, here: Array) -> tuple[Array, Array, Array]:
    """Gap ahead (n,) m, closing speed (n,) m/s and lateral push (n,) m caused by the others."""
    heading = world.heading()
    direction = np.column_stack([np.cos(heading), np.sin(heading)])
    others = world.active & world.active[:, None] & ~np.eye(len(heading), dtype=bool)
    along = np.cos(heading[:, None] - heading)
    distance = _free_distance(world, here, direction, others, along)
    nearest = distance.argmin(axis=1)
    row = np.arange(len(heading))
    closing = world.speed - (along[row, nearest] * world.speed[nearest]).clip(min=0.0)
    offset = here[None] - here[:, None]
    front = (offset * direction[:, None]).sum(-1)
    left = direction[:, None, 0] * offset[..., 1] - direction[:, None, 1] * offset[..., 0]
    close = others & (front > 0.0) & (front < 5.0) & (np.abs(left) < 1.4)
    push = (np.where(left > -0.05, -0.5, 0.5) * close).sum(axis=1).clip(-0.8, 0.8)
    return distance[row, nearest], closing, push


def _free_distance(
    world: _World, here: Array, direction: Array, others: NDArray[np.bool_], along: Array
) -> Array:
    """Distance (n, n) m that each can travel along its route before it meets each other.

    Who is in the way now makes everybody brake who does not come towards him; who will be in the
    way makes those brake who come later in the order, and all if it is less than 1.5 s ahead.
    """
    count = len(here)
    side = np.repeat(world.side[:, None], len(LOOK_M), axis=1)
    ahead = world.position(world.arc[:, None] + LOOK_M, side)
    arrival = LOOK_M / np.maximum(world.speed, 1.0)[:, None]
    velocity = direction * world.speed[:, None]
    reach = (world.radius[:, None] + world.radius + 0.35)[..., None]
    offset = ahead[:, None] - here[None, :, None]
    now = _distance_to_body(offset, direction, world.length) < reach
    later_offset = offset - velocity[None, :, None] * arrival[:, None, :, None]
    later = _distance_to_body(later_offset, direction, world.length) < reach
    yields = (np.arange(count)[None, :] < np.arange(count)[:, None])[..., None]
    yields = yields | (arrival < 1.5)[:, None]
    brakes = now & (others & (along > -0.5))[..., None]
    brakes |= later & (others & (np.abs(along) < 0.7))[..., None] & yields
    return np.where(brakes, LOOK_M, FREE_M).min(axis=-1) - 0.5 * world.length[:, None] - 0.3


def _distance_to_body(offset: Array, direction: Array, length: Array) -> Array:
    """Distance (n, n, m) m of points to the middle lines of bodies; offset (n, n, m, 2) m."""
    forward = (offset * direction[None, :, None]).sum(-1)
    beyond = np.maximum(np.abs(forward) - 0.5 * length[None, :, None], 0.0)
    across = (
        direction[None, :, None, 0] * offset[..., 1] - direction[None, :, None, 1] * offset[..., 0]
    )
    return np.hypot(beyond, across)


def _gap_to_red(world: _World, plan: SignalPlan, time_s: float) -> Array:
    """Distance to the stop line (n,) m where the light says stop, else far."""
    state = plan.state(world.arm, time_s)
    gap = world.stop - world.arc - 0.5 * world.length
    too_late = (state == YELLOW) & (world.speed**2 > 2.0 * 3.0 * np.maximum(gap, 0.1))
    go = (state == GREEN) | (state == RED_YELLOW) | too_late | (gap < -0.2)
    return np.where(go, FREE_M, np.maximum(gap + GAP_M, 0.3))
