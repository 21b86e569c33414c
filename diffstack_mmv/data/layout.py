"""How an export lies on disk: one .npy file per field, one entry per window."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from diffstack_mmv.data.settings import WindowSettings
from diffstack_mmv.types import Motion, Pose, StackBatch, Tracks

MOTION_COLUMNS = 6  # x, y, heading, forward and left velocity, yaw rate
FRAME_COLUMNS = 3  # x, y, heading of the ego at present, in the world of the recording
PER_NEIGHBOR = ("neighbors", "neighbors_valid", "neighbors_extent", "neighbors_mode")


class FieldLayout(NamedTuple):
    """Shape of one window's entry, and its type."""

    shape: tuple[int, ...]
    dtype: type[np.generic]


def fields(windows: WindowSettings) -> dict[str, FieldLayout]:
    """Fields of an export; neighbors are padded to their largest number."""
    rows, neighbors = windows.rows, windows.neighbors
    return {
        "ego": FieldLayout((rows, MOTION_COLUMNS), np.float32),
        "ego_extent": FieldLayout((2,), np.float32),
        "ego_mode": FieldLayout((), np.int16),
        "frame": FieldLayout((FRAME_COLUMNS,), np.float64),
        "neighbors": FieldLayout((neighbors, rows, MOTION_COLUMNS), np.float32),
        "neighbors_valid": FieldLayout((neighbors, rows), np.bool_),
        "neighbors_extent": FieldLayout((neighbors, 2), np.float32),
        "neighbors_mode": FieldLayout((neighbors,), np.int16),
        "neighbors_count": FieldLayout((), np.int16),
    }


def create(folder: Path, count: int, layout: dict[str, FieldLayout]) -> None:
    """Create the files for `count` windows, all zero; sparse where the file system can."""
    for name, (shape, dtype) in layout.items():
        np.lib.format.open_memmap(folder / f"{name}.npy", "w+", dtype, (count, *shape))


def write_windows(path: Path, first: int, windows: NDArray[np.generic]) -> None:
    """Overwrite consecutive windows (n, ...) of an array file.

    Written through the file, not through a memory map, so that a full disk is an error and not a
    crash. Zeros at the end of a window are not written.

    Raises:
        OSError: The disk is full.
    """
    array = np.load(path, mmap_mode="r")
    width = array.itemsize * int(np.prod(array.shape[1:]))
    content = np.ascontiguousarray(windows, dtype=array.dtype)
    with path.open("r+b") as file:
        for number, window in enumerate(content):
            used = np.flatnonzero(window.reshape(-1))
            length = int(used[-1]) + 1 if used.size else 0
            file.seek(array.offset + (first + number) * width)
            file.write(window.reshape(-1)[:length].tobytes())


def pack(batch: StackBatch) -> dict[str, NDArray[np.generic]]:
    """Lay a batch out as fields of shape (B, ...); neighbors the batch lacks are left out."""
    ego, neighbors = batch.ego_past, batch.neighbors_past
    valid = torch.cat([neighbors.valid, batch.neighbors_future.valid], -1)
    packed = {
        "ego": _pack_motion(ego.motion, batch.ego_future.motion),
        "ego_extent": ego.extent,
        "ego_mode": ego.mode,
        "frame": _pack_frame(batch.frame),
        "neighbors": _pack_motion(neighbors.motion, batch.neighbors_future.motion),
        "neighbors_valid": valid,
        "neighbors_extent": neighbors.extent,
        "neighbors_mode": neighbors.mode,
        "neighbors_count": (valid.any(-1).flip(-1).cumsum(-1) > 0).sum(-1),
    }
    return {name: tensor.numpy() for name, tensor in packed.items()}


def unpack(packed: dict[str, Tensor], windows: WindowSettings) -> StackBatch:
    """Build a batch of fields; the opposite of `pack`.

    Args:
        packed: The fields, each of shape (B, ...) with the rest as in `fields`, m, rad, m/s.
        windows: Which rows are the past, and the step.
    """
    present = packed["ego"].new_ones(packed["ego"].shape[:-1], dtype=torch.bool)
    ego = _unpack_tracks(
        packed["ego"], packed["ego_extent"], packed["ego_mode"], present, windows.past_rows
    )
    neighbors = _unpack_tracks(
        packed["neighbors"],
        packed["neighbors_extent"],
        packed["neighbors_mode"],
        packed["neighbors_valid"],
        windows.past_rows,
    )
    goal = ego[1].motion.position[..., -1, :].clone()
    position, heading = packed["frame"].split([2, 1], -1)
    frame = Pose(position, heading.squeeze(-1), present[..., 0])
    return StackBatch(*ego, *neighbors, goal, windows.dt_s, frame)


def _pack_frame(frame: Pose | None) -> Float[Tensor, "*b 3"]:
    if frame is None:
        raise TypeError("Only samples of a recording are exported: they know their frame.")
    return torch.cat([frame.position, frame.heading[..., None]], -1)


def _pack_motion(past: Motion, future: Motion) -> Float[Tensor, "*b T 6"]:
    parts = [
        torch.cat([m.position, m.heading[..., None], m.velocity, m.yaw_rate[..., None]], -1)
        for m in (past, future)
    ]
    return torch.cat(parts, -2)


def _unpack_motion(columns: Float[Tensor, "*b T 6"]) -> Motion:
    position, heading, velocity, rate = columns.split([2, 1, 2, 1], -1)
    return Motion(position, heading.squeeze(-1), velocity, rate.squeeze(-1))


def _unpack_tracks(
    columns: Float[Tensor, "*b T 6"],
    extent: Float[Tensor, "*b 2"],
    mode: Tensor,
    valid: Bool[Tensor, "*b T"],
    past_rows: int,
) -> tuple[Tracks, Tracks]:
    past, future = columns[..., :past_rows, :], columns[..., past_rows:, :]
    mode = mode.long()
    return (
        Tracks(_unpack_motion(past), extent, mode, valid[..., :past_rows]),
        Tracks(_unpack_motion(future), extent, mode, valid[..., past_rows:]),
    )
