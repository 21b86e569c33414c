"""Augmentations that add noise to what was observed, and leave the future as it is."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from diffstack_mmv.checks import require_between, require_positive
from diffstack_mmv.data.augment import like, uniform
from diffstack_mmv.data.motions import STANDSTILL_MPS, yaw_rate
from diffstack_mmv.geometry import rotate
from diffstack_mmv.types import Motion, StackBatch, Tracks


@dataclass(frozen=True)
class PositionNoise:
    """Noise on the observed past of the ego and its neighbors, not on the future.

    The present of the ego stays the origin of the frame.

    Attributes:
        std_m: Standard deviation in m in each direction.
        probability: Share of the samples that are noisy: below one, a predictor has to tell a noisy
            track from a smooth one.

    Raises:
        ValueError: The deviation is not positive, or the probability is not in [0, 1].
    """

    std_m: float = 0.02
    probability: float = 1.0

    def __post_init__(self) -> None:
        require_positive("std_m", self.std_m)
        require_between("probability", self.probability, 0.0, 1.0)

    def __call__(self, batch: StackBatch, generator: Generator) -> StackBatch:
        """Move each past position on its own."""
        chosen = uniform(batch, 0.0, 1.0, generator) < self.probability
        std = torch.where(chosen, self.std_m, 0.0).to(batch.goal)
        ego = self._moved(batch.ego_past, std, generator)
        position = ego.motion.position.clone()
        position[..., -1, :] = batch.ego_past.motion.position[..., -1, :]
        ego = ego._replace(motion=ego.motion._replace(position=position))
        return batch._replace(
            ego_past=ego, neighbors_past=self._moved(batch.neighbors_past, std, generator)
        )

    def _moved(self, tracks: Tracks, std: Float[Tensor, " B"], generator: Generator) -> Tracks:
        position = tracks.motion.position
        noise = torch.randn(position.shape, generator=generator, dtype=position.dtype)
        moved = position + like(std, position) * noise * tracks.valid[..., None]
        return tracks._replace(motion=tracks.motion._replace(position=moved))


@dataclass(frozen=True)
class RecordingNoise:
    """Less accurate positions of the past, and the motion that a recording would derive from them.

    For tracks whose velocities are backward differences (`smoother=none`) and whose headings are
    those of the motion: the present is as noisy as the rest, a velocity has the noise of two
    positions, and who hardly moves keeps the heading of before. `PositionNoise` leaves velocities
    as they are, from which a predictor learns to trust them.

    Attributes:
        most_m: Largest standard deviation in m in each direction; each sample has one of its own,
            evenly between zero and this, so that a predictor has to see how noisy a track is.
        dt_s: Length of one step in s.
        probability: Share of the samples that are noisy.

    Raises:
        ValueError: The deviation or the step is not positive, or the probability is not in [0, 1].
    """

    most_m: float
    dt_s: float
    probability: float = 1.0

    def __post_init__(self) -> None:
        require_positive("most_m", self.most_m)
        require_positive("dt_s", self.dt_s)
        require_between("probability", self.probability, 0.0, 1.0)

    def __call__(self, batch: StackBatch, generator: Generator) -> StackBatch:
        """Move each past position on its own; velocity, heading and yaw rate follow."""
        chosen = uniform(batch, 0.0, 1.0, generator) < self.probability
        std = torch.where(chosen, uniform(batch, 0.0, self.most_m, generator), 0.0).to(batch.goal)
        return batch._replace(
            ego_past=self._moved(batch.ego_past, std, generator),
            neighbors_past=self._moved(batch.neighbors_past, std, generator),
        )

    def _moved(self, tracks: Tracks, std: Float[Tensor, " B"], generator: Generator) -> Tracks:
        motion, valid = tracks.motion, tracks.valid
        drawn = torch.randn(motion.position.shape, generator=generator, dtype=motion.position.dtype)
        noise = like(std, drawn) * drawn * valid[..., None]
        both = (valid[..., 1:] & valid[..., :-1])[..., None]
        rate = noise.diff(dim=-2) * both / self.dt_s
        velocity = rotate(motion.velocity, motion.heading)
        velocity = torch.cat([velocity[..., :1, :], velocity[..., 1:, :] + rate], -2)
        moving = valid & (velocity.norm(dim=-1) >= STANDSTILL_MPS)
        heading = _held(torch.atan2(velocity[..., 1], velocity[..., 0]), moving, motion.heading)
        changed = Motion(
            motion.position + noise,
            heading * valid,
            rotate(velocity, -heading) * valid[..., None],
            yaw_rate(heading, moving, self.dt_s) * valid,
        )
        noisy = like(std, valid) > 0.0
        kept = (
            torch.where(noisy[(..., *(None,) * (new.dim() - valid.dim()))], new, old)
            for new, old in zip(changed, motion, strict=True)
        )
        return tracks._replace(motion=Motion(*kept))


def _held(
    angle: Float[Tensor, "*b T"], moving: Tensor, before: Float[Tensor, "*b T"]
) -> Float[Tensor, "*b T"]:
    """Angles of the latest row that moves; `before` where none has yet."""
    row = torch.arange(angle.shape[-1], device=angle.device)
    latest = torch.where(moving, row, -1).cummax(-1).values
    return torch.where(latest >= 0, angle.gather(-1, latest.clamp(min=0)), before)
