"""From trajdata's `AgentBatch` to a `StackBatch`; behind this point no trajdata type appears."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad
from trajdata.data_structures.batch import AgentBatch

from diffstack_mmv.data.motions import tracks_of
from diffstack_mmv.data.registration import EXACT_FRAME
from diffstack_mmv.data.settings import WindowSettings
from diffstack_mmv.types import Motion, Pose, StackBatch, Tracks


def stack_batch(batch: AgentBatch, windows: WindowSettings) -> StackBatch:
    """Convert a batch whose elements are in the frame of their agent (x, y, vx, vy, heading).

    Body velocities come from the velocities of the smoothed track, yaw rates from differences of
    its heading. Neighbors are as many as in the fullest element; absent rows and agents are zero.

    Args:
        batch: Collated with padding outside (past on the left, future on the right).
        windows: Rows and step.

    Returns:
        Samples in float32, in the frame of the ego at the last row of its past; where that lies in
        the world is told in float64.
    """
    past, future = windows.past_rows, windows.future_rows
    ego = _states(batch.agent_hist, batch.agent_fut, past, future)
    neighbors = _states(batch.neigh_hist, batch.neigh_fut, past, future)
    ego_tracks = tracks_of(
        ego, batch.agent_hist_extent[:, -1], batch.agent_type, past, windows.dt_s
    )
    extent = batch.neigh_hist_extents
    extent = extent[:, :, -1] if extent.shape[-2] else extent.new_zeros(*extent.shape[:2], 3)
    other_tracks = tracks_of(neighbors, extent, batch.neigh_types, past, windows.dt_s)
    ego_past, ego_future = _split(ego_tracks, past)
    neighbors_past, neighbors_future = _split(other_tracks, past)
    goal = ego_future.motion.position[..., -1, :]
    frame = _pose(batch.extras.get(EXACT_FRAME, batch.agents_from_world_tf).double())
    return StackBatch(
        ego_past, ego_future, neighbors_past, neighbors_future, goal, windows.dt_s, frame
    )


def _pose(agents_from_world: Float[Tensor, "B 3 3"]) -> Pose:
    """Pose of frames in the world, from the transformations into them."""
    turn, offset = agents_from_world[:, :2, :2], agents_from_world[:, :2, 2:]
    position = -(turn.transpose(-1, -2) @ offset).squeeze(-1)
    heading = torch.atan2(turn[:, 0, 1], turn[:, 0, 0])
    return Pose(position, heading, torch.ones_like(heading, dtype=torch.bool))


def _states(
    past: Tensor, future: Tensor, past_rows: int, future_rows: int
) -> Float[Tensor, "*b T 5"]:
    """Join past and future to one stretch of full length; rows that are not there are NaN."""
    past, future = past.as_subclass(Tensor).float(), future.as_subclass(Tensor).float()
    past = pad(past, (0, 0, past_rows - past.shape[-2], 0), value=torch.nan)
    future = pad(future, (0, 0, 0, future_rows - future.shape[-2]), value=torch.nan)
    return torch.cat([past, future], -2)


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
