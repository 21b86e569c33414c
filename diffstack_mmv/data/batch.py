"""From trajdata's `AgentBatch` to a `StackBatch`; behind this point no trajdata type appears."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import pad
from trajdata.data_structures.batch import AgentBatch

from diffstack_mmv.data.settings import WindowSettings
from diffstack_mmv.geometry import rotate, wrap_angle
from diffstack_mmv.types import Motion, Pose, StackBatch, Tracks

STANDSTILL_MPS = (
    0.5  # above the speed below which headings are held, so that no jump on starting counts
)
LARGEST_YAW_RATE = 4.0  # rad/s; more is a jump of the heading, not a motion


def stack_batch(batch: AgentBatch, windows: WindowSettings) -> StackBatch:
    """Convert a batch whose elements are in the frame of their agent (x, y, vx, vy, heading).

    Body velocities come from the velocities of the smoothed track, yaw rates from differences of
    its heading. Neighbors are as many as in the fullest element; absent rows and agents are zero.

    Args:
        batch: Collated with padding outside (past on the left, future on the right).
        windows: Rows and step.

    Returns:
        Samples in float32, in the frame of the ego at the last row of its past.
    """
    past, future = windows.past_rows, windows.future_rows
    ego = _states(batch.agent_hist, batch.agent_fut, past, future)
    neighbors = _states(batch.neigh_hist, batch.neigh_fut, past, future)
    ego_tracks = _tracks(ego, batch.agent_hist_extent[:, -1], batch.agent_type, windows)
    extent = batch.neigh_hist_extents
    extent = extent[:, :, -1] if extent.shape[-2] else extent.new_zeros(*extent.shape[:2], 3)
    other_tracks = _tracks(neighbors, extent, batch.neigh_types, windows)
    ego_past, ego_future = _split(ego_tracks, past)
    neighbors_past, neighbors_future = _split(other_tracks, past)
    goal = ego_future.motion.position[..., -1, :]
    frame = _pose(batch.agents_from_world_tf)
    return StackBatch(
        ego_past, ego_future, neighbors_past, neighbors_future, goal, windows.dt_s, frame
    )


def _pose(agents_from_world: Float[Tensor, "B 3 3"]) -> Pose:
    """Pose of frames in the world, from the transformations into them."""
    turn, offset = agents_from_world[:, :2, :2], agents_from_world[:, :2, 2:]
    position = -(turn.transpose(-1, -2) @ offset).squeeze(-1).float()
    heading = torch.atan2(turn[:, 0, 1], turn[:, 0, 0]).float()
    return Pose(position, heading, torch.ones_like(heading, dtype=torch.bool))


def _states(
    past: Tensor, future: Tensor, past_rows: int, future_rows: int
) -> Float[Tensor, "*b T 5"]:
    """Join past and future to one stretch of full length; rows that are not there are NaN."""
    past, future = past.as_subclass(Tensor).float(), future.as_subclass(Tensor).float()
    past = pad(past, (0, 0, past_rows - past.shape[-2], 0), value=torch.nan)
    future = pad(future, (0, 0, 0, future_rows - future.shape[-2]), value=torch.nan)
    return torch.cat([past, future], -2)


def _tracks(
    states: Float[Tensor, "*b T 5"],
    extent: Float[Tensor, "*b 3"],
    mode: Tensor,
    windows: WindowSettings,
) -> Tracks:
    valid = states.isfinite().all(-1)
    position, velocity, heading = states.nan_to_num(0.0, 0.0, 0.0).split([2, 2, 1], -1)
    heading = wrap_angle(heading.squeeze(-1)) * valid
    moving = valid & (velocity.norm(dim=-1) >= STANDSTILL_MPS)
    rows = windows.past_rows
    # the yaw rate of the present must not look at the future
    past_rate = yaw_rate(heading[..., :rows], moving[..., :rows], windows.dt_s)
    future_rate = yaw_rate(heading, moving, windows.dt_s)[..., rows:]
    motion = Motion(
        position * valid[..., None],
        heading,
        rotate(velocity, -heading) * valid[..., None],
        torch.cat([past_rate, future_rate], -1),
    )
    size = extent[..., :2].as_subclass(Tensor).float().nan_to_num(0.0)
    known = mode.nan_to_num(0.0).clamp(min=0).long() if mode.is_floating_point() else mode.long()
    return Tracks(motion, size, known, valid)


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


def _split(tracks: Tracks, rows: int) -> tuple[Tracks, Tracks]:
    position, heading, velocity, rate = tracks.motion
    past = Motion(
        position[..., :rows, :], heading[..., :rows], velocity[..., :rows, :], rate[..., :rows]
    )
    future = Motion(
        position[..., rows:, :], heading[..., rows:], velocity[..., rows:, :], rate[..., rows:]
    )
    return (
        tracks._replace(motion=past, valid=tracks.valid[..., :rows]),
        tracks._replace(motion=future, valid=tracks.valid[..., rows:]),
    )
