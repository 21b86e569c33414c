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
    """Classify windows by the recorded positions of the ego, past and future.

    moving: the path over the window is at least 7 m.
    standing: never more than 1 m from the present.
    starting: slower than 0.5 m/s over the first second of the window, at least 1 m/s over the last;
    stopping: the reverse.
    turning: moving, and the course covers a range of at least 20 degrees; straight: moving and not
    turning.

    Speed and course are those of the displacement over a second, and a course counts at 1 m/s and
    more: the noise of positions is no motion, and the heading of somebody who starts is no turn.
    """
    position = torch.cat([batch.ego_past.motion.position, batch.ego_future.motion.position], -2)
    second = min(max(round(1.0 / batch.dt_s), 1), position.shape[-2] - 1)
    displacement = position[..., second:, :] - position[..., :-second, :]
    speed = displacement.norm(dim=-1) / (second * batch.dt_s)
    first, last = speed[..., 0], speed[..., -1]
    moving = position.diff(dim=-2).norm(dim=-1).sum(-1) >= MOVING_PATH
    course = torch.atan2(displacement[..., 1], displacement[..., 0])
    turning = moving & (angle_range(course, speed >= FAST) >= TURN)
    reach = (position - batch.ego_past.motion.position[..., -1:, :]).norm(dim=-1).amax(-1)
    return Situations(
        moving=moving,
        standing=reach < STANDING_REACH,
        starting=(first < SLOW) & (last >= FAST),
        stopping=(last < SLOW) & (first >= FAST),
        straight=moving & ~turning,
        turning=turning,
    )


def angle_range(angle: Float[Tensor, "*b T"], counted: Bool[Tensor, "*b T"]) -> Float[Tensor, "*b"]:
    """Largest minus smallest angle in rad over the counted rows, whole turns removed."""
    # a row that is not counted repeats the last counted one, so that its jumps do not add up
    latest = torch.where(counted, torch.arange(angle.shape[-1], device=angle.device), 0)
    held = angle.gather(-1, latest.cummax(-1).values)
    steps = wrap_angle(held.diff(dim=-1))
    unwrapped = torch.cat([torch.zeros_like(angle[..., :1]), steps.cumsum(-1)], -1)
    highest = unwrapped.masked_fill(~counted, -torch.inf).amax(-1)
    lowest = unwrapped.masked_fill(~counted, torch.inf).amin(-1)
    return (highest - lowest).clamp(min=0)
