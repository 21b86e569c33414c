"""Tracks cut into segments of equal length, for multiple shooting.

The stages of a track (its steps, and the last sample) are dealt out evenly; the last segment may be
padded. A node is the start of a segment but the first: the first begins at the placement.
"""

import math

from jaxtyping import Float, Shaped
from torch import Tensor
from torch.nn.functional import pad


def segment_count(stages: int, segment_steps: int | None) -> int:
    """How many segments of at most so many steps a track is cut into; one without a limit."""
    return 1 if segment_steps is None else math.ceil(stages / segment_steps)


def segment_length(stages: int, segments: int) -> int:
    """Steps of each segment."""
    return math.ceil(stages / segments)


def node_times(stages: int, nodes: int) -> slice:
    """Where on the track the nodes lie."""
    length = segment_length(stages, nodes + 1)
    return slice(length, (nodes + 1) * length, length)


def segmented(
    rows: Shaped[Tensor, "N T1 *rest"], segments: int
) -> Shaped[Tensor, "N segments length *rest"]:
    """Stages by segment, zeros in the padding."""
    stages = rows.shape[1]
    length = segment_length(stages, segments)
    missing = segments * length - stages
    padded = pad(rows, (0, 0) * (rows.dim() - 2) + (0, missing))
    return padded.unflatten(1, (segments, length))


def connected(
    rows: Float[Tensor, "N segments length *rest"], stages: int
) -> Float[Tensor, "N T1 *rest"]:
    """Undo `segmented`."""
    return rows.flatten(1, 2)[:, :stages]
