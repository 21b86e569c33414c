"""What the ego does over a window: standing, starting, stopping, going straight or turning."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.types import StackBatch

MOVING_PATH = 7.0  # m over the whole window
STANDING_REACH = 1.0  # m from the position of the present
SLOW = 0.5  # m/s, mean over a second: not going yet, or no more
FAST = 1.0  # m/s, mean over a second: going
TURN = torch.pi / 9  # rad


class Situations(NamedTuple):
    """Which situations a window belongs to; several may be true, e.g. `starting` and `turning`."""

    moving: Bool[Tensor, "*b"]
    standing: Bool[Tensor, "*b"]
    starting: Bool[Tensor, "*b"]
    stopping: Bool[Tensor, "*b"]
    straight: Bool[Tensor, "*b"]
    turning: Bool[Tensor, "*b"]


def situations(batch: StackBatch) -> Situations:
    """Classify windows by the recorded motion of the ego, past and future.

    moving: the path over the window is at least 7 m.
    standing: never more than 1 m from the present.
    starting: slower than 0.5 m/s over the first second of the window, at least 1 m/s over the last;
    stopping: the reverse.
    turning: moving, and the heading, where the ego is faster than 0.5 m/s, covers a range of at
    least 20 degrees; straight: moving and not turning.

    Speeds are mean displacements over a second: noise at standstill does not count as motion.
    """
    past, future = batch.ego_past.motion, batch.ego_future.motion
    position = torch.cat([past.position, future.position], -2)
    heading = torch.cat([past.heading, future.heading], -1)
    speed = torch.cat([past.velocity, future.velocity], -2).norm(dim=-1)
    second = min(max(round(1.0 / batch.dt_s), 1), position.shape[-2] - 1)
    seconds = second * batch.dt_s
    first = (position[..., second, :] - position[..., 0, :]).norm(dim=-1) / seconds
    last = (position[..., -1, :] - position[..., -1 - second, :]).norm(dim=-1) / seconds
    moving = position.diff(dim=-2).norm(dim=-1).sum(-1) >= MOVING_PATH
    turning = moving & (heading_range(heading, speed > SLOW) >= TURN)
    starting, stopping = (first < SLOW) & (last >= FAST), (last < SLOW) & (first >= FAST)
    reach = (position - past.position[..., -1:, :]).norm(dim=-1).amax(-1)
    standing = reach < STANDING_REACH
    return Situations(moving, standing, starting, stopping, moving & ~turning, turning)


def heading_range(
    heading: Float[Tensor, "*b T"], counted: Bool[Tensor, "*b T"]
) -> Float[Tensor, "*b"]:
    """Largest minus smallest heading in rad over the counted rows, whole turns removed."""
    step = wrap_angle(heading.diff(dim=-1))
    unwrapped = torch.cat([torch.zeros_like(heading[..., :1]), step.cumsum(-1)], -1)
    highest = unwrapped.masked_fill(~counted, -torch.inf).amax(-1)
    lowest = unwrapped.masked_fill(~counted, torch.inf).amin(-1)
    return (highest - lowest).clamp(min=0)
