"""Shooting intervals: tracks divided evenly for multiple shooting.

The stages of a track (its steps, and the last sample) are divided evenly; the last interval may
be padded. A node is the state at the start of an interval; the first interval has none, because it
begins at the initial condition.
"""

import math

from jaxtyping import Float, Shaped
from torch import Tensor
from torch.nn.functional import pad


def interval_count(stages: int, max_steps: int | None) -> int:
    """Number of shooting intervals of at most `max_steps` steps; one without a limit."""
    return 1 if max_steps is None else math.ceil(stages / max_steps)


def interval_length(stages: int, intervals: int) -> int:
    """Steps of each interval."""
    return math.ceil(stages / intervals)


def node_times(stages: int, nodes: int) -> slice:
    """Stages at which the nodes lie."""
    length = interval_length(stages, nodes + 1)
    return slice(length, (nodes + 1) * length, length)


def split_intervals(
    rows: Shaped[Tensor, "N T1 *rest"], intervals: int
) -> Shaped[Tensor, "N intervals length *rest"]:
    """Stages by interval, zeros in the padding."""
    stages = rows.shape[1]
    length = interval_length(stages, intervals)
    missing = intervals * length - stages
    padded = pad(rows, (0, 0) * (rows.dim() - 2) + (0, missing))
    return padded.unflatten(1, (intervals, length))


def join_intervals(
    rows: Float[Tensor, "N intervals length *rest"], stages: int
) -> Float[Tensor, "N T1 *rest"]:
    """Undo `split_intervals`."""
    return rows.flatten(1, 2)[:, :stages]
