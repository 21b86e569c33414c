"""Agents of a batch of scenes as rows: those that are observed now, each in its own frame."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.geometry import motion_in_frame, position_from_frame, rotate
from diffstack_mmv.prediction.current import (
    Trend,
    current_course,
    current_heading,
    current_position,
)
from diffstack_mmv.prediction.trajectron.rows import ChosenRows, chosen
from diffstack_mmv.prediction.trajectron.start import estimates
from diffstack_mmv.types import Mode, Motion, Pose, Tracks, map_tensors, on_host

PEDESTRIANS = (Mode.UNKNOWN, Mode.PEDESTRIAN, Mode.STROLLER)
EGO, VEHICLE, PEDESTRIAN = (
    0,
    1,
    2,
)  # roles; the kinds of the encoders are VEHICLE and PEDESTRIAN alone


class AgentBatch(NamedTuple):
    """R agents, each seen in a frame in its last position and on the course of its fit.

    Velocity and acceleration are those of the fit; `starts` are estimates to choose from. Where
    rows are not gathered, see `chosen`, there is one for each agent, whether present or not.
    """

    index: Int[Tensor, " R"]  # scene * agents + agent
    present: Bool[Tensor, " R"]
    role: Int[Tensor, " R"]  # EGO, VEHICLE or PEDESTRIAN
    kind: Int[Tensor, " R"]  # VEHICLE or PEDESTRIAN
    origin: Float[Tensor, "R 2"]  # m, of the own frame in the frame of the scene
    heading: Float[Tensor, " R"]  # rad, of the own frame in the frame of the scene
    past: Tracks  # R H, in the own frame
    velocity: Float[Tensor, "R 2"]  # m/s now, in the own frame, from the fit to the track
    acceleration: Float[Tensor, "R 2"]  # m/s² now, in the own frame
    starts: Trend  # R S, in the own frame, see `start.estimates`
    place: Pose  # R, of the own frame in the world of the recording


def agent_batch(agents: Tracks, dt_s: float, frame: Pose | None = None) -> AgentBatch:
    """Rows of the present agents of scenes `B A`.

    Args:
        agents: Observed agents `B A H`, the ego of each scene first.
        dt_s: Length of one step in s.
        frame: Where the scenes lie in the world, `B`; None if that is not known.
    """
    index, present = chosen(agents.valid[..., -1].flatten())
    scene_tracks = take_rows(agents, index)
    found = estimates(scene_tracks, dt_s)
    origin = current_position(scene_tracks)
    heading = current_course(found.velocity[:, 0], current_heading(scene_tracks))
    starts = Trend(*(rotate(field, -heading.unsqueeze(-1)) for field in found))
    kind = agent_kind(scene_tracks.mode)
    is_ego = index % agents.mode.shape[1] == 0
    return AgentBatch(
        index=index,
        present=torch.ones_like(is_ego) if present is None else present,
        role=torch.where(is_ego, torch.full_like(kind, EGO), kind),
        kind=kind,
        origin=origin,
        heading=heading,
        past=in_own_frame(scene_tracks, origin, heading),
        velocity=starts.velocity[:, 0],
        acceleration=starts.acceleration[:, 0],
        starts=starts,
        place=_place(frame, index // agents.mode.shape[1], origin, heading),
    )


def _place(
    frame: Pose | None,
    scene: Int[Tensor, " R"],
    origin: Float[Tensor, "R 2"],
    heading: Float[Tensor, " R"],
) -> Pose:
    """Poses in the world of frames in the frames of their scenes."""
    if frame is None:
        return Pose(origin, heading, torch.zeros_like(scene, dtype=torch.bool))
    position, turn, known = (field[scene] for field in frame)
    return Pose(position_from_frame(origin, position, turn), turn + heading, known)


def agent_kind(mode: Int[Tensor, "*b"]) -> Int[Tensor, "*b"]:
    """PEDESTRIAN for those who can step sideways, VEHICLE for all others."""
    walks = torch.stack([mode == int(pedestrian) for pedestrian in PEDESTRIANS]).any(0)
    return torch.where(walks, torch.full_like(mode, PEDESTRIAN), torch.full_like(mode, VEHICLE))


def rows_of_role(rows: AgentBatch, role: int, agents: int) -> ChosenRows:
    """Places of the present rows of a role, with so many `agents` per scene."""
    mask = rows.present & (rows.role == role)
    if on_host(mask):
        return chosen(mask)
    place = torch.arange(len(mask), device=mask.device).reshape(-1, agents)
    return chosen(mask, place[:, 0] if role == EGO else place[:, 1:].flatten())


def take_rows(agents: Tracks, index: Int[Tensor, " R"]) -> Tracks:
    """Agents `*b` by their flat index."""
    dims = agents.mode.dim()
    return map_tensors(lambda field: field.flatten(0, dims - 1)[index], agents)


def select_agents(rows: AgentBatch, place: Int[Tensor, " S"]) -> AgentBatch:
    """Rows at some places."""
    return map_tensors(lambda field: field[place], rows)


def in_own_frame(
    tracks: Tracks, origin: Float[Tensor, "R 2"], heading: Float[Tensor, " R"]
) -> Tracks:
    """Tracks `R T` in frames with that origin (m) and heading (rad), zero where not valid."""
    motion = motion_in_frame(tracks.motion, origin.unsqueeze(-2), heading.unsqueeze(-1))

    def cleared(field: Tensor) -> Tensor:
        known: Bool[Tensor, "..."] = tracks.valid[
            (..., *(None,) * (field.dim() - tracks.valid.dim()))
        ]
        return torch.where(known, field, torch.zeros_like(field))

    return tracks._replace(motion=Motion(*(cleared(field) for field in motion)))
