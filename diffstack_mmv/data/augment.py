"""Augmentations of training batches; all that is random comes from the generator that is passed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Generator, Tensor

from diffstack_mmv.checks import require_at_least, require_between, require_positive
from diffstack_mmv.geometry import rotate, wrap_angle
from diffstack_mmv.types import Motion, StackBatch, Tracks

MotionMap = Callable[[Motion], Motion]


@runtime_checkable
class Augmentation(Protocol):
    """Changes a batch at random and keeps it physical."""

    def __call__(self, batch: StackBatch, generator: Generator) -> StackBatch:
        """Return the changed batch; the same generator state gives the same result."""
        ...


class Chain:
    """Several augmentations, one after the other."""

    def __init__(self, augmentations: Sequence[Augmentation]) -> None:
        """Apply `augmentations` in this order."""
        self.augmentations = tuple(augmentations)

    def __call__(self, batch: StackBatch, generator: Generator) -> StackBatch:
        """Return the changed batch."""
        for augmentation in self.augmentations:
            batch = augmentation(batch, generator)
        return batch


@dataclass(frozen=True)
class Mirror:
    """Exchange left and right.

    Attributes:
        probability: Share of the samples that are mirrored.

    Raises:
        ValueError: The probability is not in [0, 1].
    """

    probability: float = 0.5

    def __post_init__(self) -> None:
        require_between("probability", self.probability, 0.0, 1.0)

    def __call__(self, batch: StackBatch, generator: Generator) -> StackBatch:
        """Change the signs of y, heading, velocity to the left and yaw rate."""
        chosen = uniform(batch, 0.0, 1.0, generator) < self.probability
        sign = torch.where(chosen, -1.0, 1.0).to(batch.goal)

        def mirrored(motion: Motion) -> Motion:
            factor = like(sign, motion.heading)
            flip = torch.stack([torch.ones_like(factor), factor], -1)
            position, velocity = motion.position * flip, motion.velocity * flip
            return Motion(position, motion.heading * factor, velocity, motion.yaw_rate * factor)

        return _nowhere(_map_motions(batch, mirrored), chosen)


@dataclass(frozen=True)
class Rotation:
    """Turn the frame about the position of the ego.

    The heading of the ego in the present is then not zero any more, as if it had been observed with
    an error: for models that rely on it being exactly zero.

    Attributes:
        limit_rad: Largest angle in rad.

    Raises:
        ValueError: The angle is not positive.
    """

    limit_rad: float = 0.1

    def __post_init__(self) -> None:
        require_positive("limit_rad", self.limit_rad)

    def __call__(self, batch: StackBatch, generator: Generator) -> StackBatch:
        """Rotate positions and headings; body velocities and yaw rates stay."""
        angle = uniform(batch, -self.limit_rad, self.limit_rad, generator)

        def rotated(motion: Motion) -> Motion:
            turn = like(angle, motion.heading)
            position = rotate(motion.position, turn.expand_as(motion.heading))
            return motion._replace(position=position, heading=wrap_angle(motion.heading + turn))

        changed = _keep_absent_zero(_map_motions(batch, rotated))
        if batch.frame is None:
            return changed
        frame = batch.frame._replace(heading=wrap_angle(batch.frame.heading - angle))
        return changed._replace(frame=frame)


@dataclass(frozen=True)
class SpeedScale:
    """Scale the plane about the ego: everybody is faster and further away by one factor per sample.

    Positions and velocities scale together, headings and yaw rates stay, so that each track remains
    consistent; turning radii and accelerations scale as well. Extents stay. No place in the world
    looks like a scaled sample: lanes and crossings are where they were.

    Attributes:
        low: Smallest factor.
        high: Largest factor.
        probability: Share of the samples that are scaled.

    Raises:
        ValueError: The factors are not positive or not in order, or the share is not in [0, 1].
    """

    low: float = 0.9
    high: float = 1.1
    probability: float = 1.0

    def __post_init__(self) -> None:
        require_positive("low", self.low)
        require_at_least("high", self.high, self.low)
        require_between("probability", self.probability, 0.0, 1.0)

    def __call__(self, batch: StackBatch, generator: Generator) -> StackBatch:
        """Scale positions and velocities."""
        scale = uniform(batch, self.low, self.high, generator)
        if self.probability < 1.0:
            chosen = uniform(batch, 0.0, 1.0, generator) < self.probability
            scale = torch.where(chosen, scale, 1.0)

        def scaled(motion: Motion) -> Motion:
            factor = like(scale, motion.heading)[..., None]
            return motion._replace(
                position=motion.position * factor, velocity=motion.velocity * factor
            )

        return _nowhere(_map_motions(batch, scaled), scale != 1.0)


def uniform(
    batch: StackBatch, low: float, high: float, generator: Generator
) -> Float[Tensor, " B"]:
    """One number between `low` and `high` for each of the B samples."""
    draws = torch.rand(len(batch.goal), generator=generator, dtype=batch.goal.dtype)
    return low + (high - low) * draws


def like(value: Float[Tensor, " B"], reference: Shaped[Tensor, "B ..."]) -> Tensor:
    """A number per sample with as many dimensions as a reference, to go with it."""
    return value.reshape(-1, *[1] * (reference.dim() - 1))


def _map_motions(batch: StackBatch, change: MotionMap) -> StackBatch:
    tracks = [track._replace(motion=change(track.motion)) for track in _all_tracks(batch)]
    return _joined(batch, tracks)


def _nowhere(batch: StackBatch, changed: Bool[Tensor, " B"]) -> StackBatch:
    """Have samples forget where in the world they are, since no place there looks like them."""
    if batch.frame is None:
        return batch
    return batch._replace(frame=batch.frame._replace(known=batch.frame.known & ~changed))


def _keep_absent_zero(batch: StackBatch) -> StackBatch:
    return _joined(batch, [_zeroed(track) for track in _all_tracks(batch)])


def _zeroed(tracks: Tracks) -> Tracks:
    valid: Bool[Tensor, "*b T"] = tracks.valid
    motion = Motion(
        *(
            part * (valid[..., None] if part.dim() > valid.dim() else valid)
            for part in tracks.motion
        )
    )
    return tracks._replace(motion=motion)


def _all_tracks(batch: StackBatch) -> list[Tracks]:
    return [batch.ego_past, batch.ego_future, batch.neighbors_past, batch.neighbors_future]


def _joined(batch: StackBatch, tracks: Sequence[Tracks]) -> StackBatch:
    ego_past, ego_future, neighbors_past, neighbors_future = tracks
    goal = ego_future.motion.position[..., -1, :]
    return batch._replace(
        ego_past=ego_past, ego_future=ego_future, neighbors_past=neighbors_past,
        neighbors_future=neighbors_future, goal=goal,
    )  # fmt: skip
