"""From rows of position, velocity and heading to the tracks of a sample."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import pad

from diffstack_mmv.geometry import rotate, wrap_angle
from diffstack_mmv.types import Motion, Tracks

STANDSTILL_MPS = 0.5
"""Above the speed below which headings are held, so that no jump on starting counts."""
LARGEST_YAW_RATE = 4.0
"""In rad/s; more is a jump of the heading, not a motion."""


def tracks_of(
    states: Float[Tensor, "*b T 5"],
    extent: Float[Tensor, "*b e"],
    mode: Tensor,
    past_rows: int,
    dt_s: float,
) -> Tracks:
    """Tracks from rows x, y, vx, vy (m, m/s, in one frame) and heading (rad).

    Body velocities are those velocities in the frame of the agent, yaw rates differences of the
    heading; those of the past do not look at the future.

    Args:
        states: Rows of past and future; those of an absent agent are NaN and become zero.
        extent: Length and width in m, and more where it is known.
        mode: Number of the mode, NaN or below zero where there is no agent.
        past_rows: How many rows belong to the past.
        dt_s: Step of the rows in s.
    """
    valid = states.isfinite().all(-1)
    position, velocity, heading = states.nan_to_num(0.0, 0.0, 0.0).split([2, 2, 1], -1)
    heading = wrap_angle(heading.squeeze(-1)) * valid
    moving = valid & (velocity.norm(dim=-1) >= STANDSTILL_MPS)
    past_rate = yaw_rate(heading[..., :past_rows], moving[..., :past_rows], dt_s)
    future_rate = yaw_rate(heading, moving, dt_s)[..., past_rows:]
    motion = Motion(
        position * valid[..., None],
        heading,
        rotate(velocity, -heading) * valid[..., None],
        torch.cat([past_rate, future_rate], -1),
    )
    size = extent[..., :2].as_subclass(Tensor).float().nan_to_num(0.0)
    known = mode.nan_to_num(0.0).clamp(min=0).long() if mode.is_floating_point() else mode.long()
    return Tracks(motion, size, known, valid)


def motion_through(
    position: Float[Tensor, "T 2"], heading: Float[Tensor, " T"], dt_s: float
) -> Motion:
    """The motion of a track, velocities from differences of positions; it looks a row ahead.

    Args:
        position: m, in the world.
        heading: rad.
        dt_s: Step of the rows in s.
    """
    (velocity,) = torch.gradient(position, spacing=dt_s, dim=0)
    moving = velocity.norm(dim=-1) >= STANDSTILL_MPS
    return Motion(position, heading, rotate(velocity, -heading), yaw_rate(heading, moving, dt_s))


def yaw_rate(
    heading: Float[Tensor, "*b T"], moving: Bool[Tensor, "*b T"], dt_s: float
) -> Float[Tensor, "*b T"]:
    """Yaw rate in rad/s: mean of the heading differences to the row before and the row after.

    A difference counts only where the agent moves at both rows, for at rest a heading is held, not
    observed; a row without such a difference gets zero. The first and the last row have one side.
    """
    both = (moving[..., 1:] & moving[..., :-1]).to(heading.dtype)
    step = wrap_angle(heading.diff(dim=-1)) / dt_s
    step = step.clamp(-LARGEST_YAW_RATE, LARGEST_YAW_RATE) * both
    count = pad(both, (1, 0)) + pad(both, (0, 1))
    return (pad(step, (1, 0)) + pad(step, (0, 1))) / count.clamp(min=1)
