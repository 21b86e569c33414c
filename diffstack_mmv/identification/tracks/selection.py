"""Which segments of the recorded tracks to prefer."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from diffstack_mmv.identification.tracks.segments import TrackSegment


@runtime_checkable
class SegmentSelection(Protocol):
    """Which segments to prefer."""

    def __call__(
        self, segments: Sequence[TrackSegment], generator: Generator
    ) -> Float[Tensor, " segments"]:
        """Score of each segment; the highest are taken."""
        ...


class RandomSelection:
    """Any segment."""

    def __call__(
        self, segments: Sequence[TrackSegment], generator: Generator
    ) -> Float[Tensor, " segments"]:
        """Random scores."""
        return torch.rand(len(segments), generator=generator, dtype=torch.float64)


class LongestSelection:
    """The segments with the longest path in m."""

    def __call__(
        self, segments: Sequence[TrackSegment], generator: Generator
    ) -> Float[Tensor, " segments"]:
        """Length of the path in m."""
        return torch.stack([each.position.diff(dim=0).norm(dim=-1).sum() for each in segments])


@dataclass(frozen=True)
class ExcitationSelection:
    """The segments with the highest lateral acceleration and yaw rate.

    The score is the root mean square of v r / a_0 plus that of r / r_0, with the yaw rate r taken
    over a second: from step to step it is mostly noise.

    Args:
        lateral_mps2: a_0, a large lateral acceleration.
        yaw_rate_radps: r_0, a large yaw rate.
        dt_s: Step of the tracks.
    """

    lateral_mps2: float = 2.0
    yaw_rate_radps: float = 0.5
    dt_s: float = 0.1

    def __call__(
        self, segments: Sequence[TrackSegment], generator: Generator
    ) -> Float[Tensor, " segments"]:
        """Excitation of each segment, dimensionless."""
        scores = []
        for each in segments:
            lag = min(round(1.0 / self.dt_s), len(each.course) - 1)
            yaw_rate = (each.course[lag:] - each.course[:-lag]) / (lag * self.dt_s)
            lateral = yaw_rate * each.speed[lag:] / self.lateral_mps2
            turning = yaw_rate / self.yaw_rate_radps
            scores.append(lateral.square().mean().sqrt() + turning.square().mean().sqrt())
        return torch.stack(scores)
