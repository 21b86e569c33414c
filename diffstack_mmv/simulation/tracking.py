"""Pedestrians tracked by a controller: measured with errors, and not always seen."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.simulation.decisions import (
    Controller,
    Decided,
    batched,
    diagnosis_of,
    thoughts_of,
    unbatched,
)
from diffstack_mmv.simulation.observation import Observation


class Tracked(NamedTuple):
    """What is believed of the pedestrians, `b h`."""

    motion: Float[Tensor, "b h 2 2"]  # (position in m, velocity in m/s) x (x, y)
    covariance: Float[Tensor, "b h 2 2"]  # of position and velocity along either axis
    unseen: Float[Tensor, "b h"]  # s since somebody was seen; infinite: never
    time: float  # s


@dataclass(frozen=True)
class PedestrianTracker:
    """A Kalman filter of constant velocity per pedestrian, which remembers who was lost.

    Attributes:
        position_m: Standard deviation of a measured coordinate.
        velocity_mps: Standard deviation of a measured velocity.
        acceleration_mps2: Standard deviation of the acceleration of a pedestrian over a step.
        memory_s: Who is not seen any more is taken to walk on for so long.

    Raises:
        ValueError: A deviation is not positive, or the time negative.
    """

    position_m: float = 0.05
    velocity_mps: float = 0.1
    acceleration_mps2: float = 1.5
    memory_s: float = 2.0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("position_m", self.position_m)
        require_positive("velocity_mps", self.velocity_mps)
        require_positive("acceleration_mps2", self.acceleration_mps2)
        require_at_least("memory_s", self.memory_s, 0)

    def __call__(self, before: Tracked | None, observation: Observation) -> Tracked:
        """What is believed after a measurement, `b h`."""
        measured = torch.stack(
            [observation.pedestrian_position, observation.pedestrian_velocity], -2
        )
        noise = torch.diag(measured.new_tensor([self.position_m**2, self.velocity_mps**2]))
        seen, time = observation.seen, float(observation.time.max())
        fresh = noise.expand(*seen.shape, 2, 2)
        if before is None:
            never = torch.full_like(measured[..., 0, 0], torch.inf)
            return Tracked(measured, fresh, torch.where(seen, 0.0, never), time)
        dt_s = time - before.time
        push = measured.new_tensor([0.5 * dt_s**2, dt_s])
        step = measured.new_tensor([[1.0, dt_s], [0.0, 1.0]])
        drift = self.acceleration_mps2**2 * push[:, None] * push
        motion = step @ before.motion
        covariance = step @ before.covariance @ step.mT + drift
        gain = covariance @ torch.linalg.inv(covariance + noise)
        corrected = motion + gain @ (measured - motion)
        known = before.unseen <= self.memory_s
        motion = self._where(seen, self._where(known, corrected, measured), motion)
        certain = covariance - gain @ covariance
        covariance = self._where(seen, self._where(known, certain, fresh), covariance)
        unseen = torch.where(seen, torch.zeros_like(before.unseen), before.unseen + dt_s)
        return Tracked(motion, covariance, unseen, time)

    def believed(self, tracked: Tracked, observation: Observation) -> Observation:
        """The observation as it is believed: filtered, with those who were lost just now."""
        known = tracked.unseen <= self.memory_s
        position, velocity = tracked.motion.unbind(-2)
        keep = known[..., None]
        return observation._replace(
            pedestrian_position=torch.where(keep, position, observation.pedestrian_position),
            pedestrian_velocity=torch.where(keep, velocity, observation.pedestrian_velocity),
            seen=known,
        )

    @staticmethod
    def _where(chosen: Bool[Tensor, "b h"], first: Tensor, second: Tensor) -> Tensor:
        return torch.where(chosen[..., None, None], first, second)


class TrackingState(NamedTuple):
    """What a tracking controller remembers."""

    tracked: Tracked | None
    inner: Any


class TrackingController:
    """Another controller that is shown the pedestrians as a tracker believes them to be.

    Args:
        controller: Decides.
        tracker: Filters and remembers.
    """

    def __init__(self, controller: Controller, tracker: PedestrianTracker) -> None:
        self.controller = controller
        self.tracker = tracker

    def init(self, observation: Observation) -> TrackingState:
        """Nothing has been tracked yet."""
        return TrackingState(None, self.controller.init(batched(observation)))

    def act(self, state: TrackingState, observation: Observation) -> Decided:
        """What the other controller decides."""
        if observation.time.dim() == 0:
            return unbatched(self, state, observation)
        tracked = self.tracker(state.tracked, observation)
        believed = self.tracker.believed(tracked, observation)
        action, inner = self.controller.act(state.inner, believed)
        return Decided(action, TrackingState(tracked, inner))

    def diagnosis(self, state: TrackingState) -> dict[str, Float[Tensor, " E"]]:
        """What the other controller tells of itself."""
        return diagnosis_of(self.controller, state.inner)

    def thoughts(self, state: TrackingState) -> dict[str, Float[np.ndarray, "E S *d"]]:
        """What the other controller expected and planned."""
        return thoughts_of(self.controller, state.inner)
