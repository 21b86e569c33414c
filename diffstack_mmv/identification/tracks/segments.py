"""Segments of recorded tracks that are fit for identification, and which of them to take."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require


class TrackSegment(NamedTuple):
    """A segment of one track in which the vehicle moves."""

    name: str
    position: Float[Tensor, "T1 2"]  # m
    course: Float[Tensor, " T1"]  # rad, direction of travel, without jumps
    speed: Float[Tensor, " T1"]  # m/s
    controls: Float[Tensor, "T1 m"] | None = None  # measured, where a data set has them
    lean: Float[Tensor, " T1"] | None = None  # rad, measured, positive to the left
    part_of: str = ""  # recording, where it is not the scene that the name begins with

    @property
    def track(self) -> str:
        """The track it was cut from, "scene/agent" in a converted cache."""
        return self.name.rpartition("@")[0] or self.name

    @property
    def recording(self) -> str:
        """The recording it was cut from: what fitted and held-out tracks must not share."""
        return self.part_of or self.track.partition("/")[0]


class SegmentBatch(NamedTuple):
    """Segments of different lengths, padded at the end with their last row."""

    names: tuple[str, ...]
    position: Float[Tensor, "N T1 2"]  # m
    course: Float[Tensor, "N T1"]  # rad
    speed: Float[Tensor, "N T1"]  # m/s
    valid: Bool[Tensor, "N T1"]
    controls: Float[Tensor, "N T1 m"] | None = None

    @property
    def samples(self) -> Float[Tensor, " N"]:
        """Number of recorded positions of each segment."""
        return self.valid.sum(-1).to(self.position)


def stack_segments(segments: Sequence[TrackSegment]) -> SegmentBatch:
    """Stack segments, the shorter ones padded with their last row.

    Raises:
        ValueError: There is none, or a position is not finite.
    """
    require(len(segments) > 0, "segments", "be at least one", 0)
    rows = max(len(each.speed) for each in segments)

    def stacked(columns: Sequence[Tensor]) -> Tensor:
        return torch.stack(
            [torch.cat([column, column[-1:].expand(rows - len(column), *column.shape[1:])])
             for column in columns]
        )  # fmt: skip

    for each in segments:
        finite = bool(each.position.isfinite().all() and each.course.isfinite().all())
        require(finite, "tracks", "be finite", "NaN or infinite positions", f"in '{each.name}'")
    lengths = torch.tensor([len(each.speed) for each in segments])
    measured = [each.controls for each in segments if each.controls is not None]
    return SegmentBatch(
        names=tuple(each.name for each in segments),
        position=stacked([each.position for each in segments]),
        course=stacked([each.course for each in segments]),
        speed=stacked([each.speed for each in segments]),
        valid=torch.arange(rows) < lengths.unsqueeze(-1),
        controls=stacked(measured) if len(measured) == len(segments) else None,
    )
