"""Reading of the two-wheeler csv files: where the wheels touch the ground, and the lean."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_converters.csv_table import read_numbers
from data_converters.errors import RejectReason, refuse_track
from data_converters.heading import direction
from data_converters.limits import USUAL, RecordingLimits

Array = NDArray[np.float64]

SAMPLES_NEEDED = 4
"""Frames that every smoother can work with."""
LENGTH_TOLERANCE = 0.01
"""How far the length of a quaternion may be off because of rounding."""

RIDER = 0
"""`obj_id` of the box of the rider; other boxes of a frame are parts of the vehicle."""

CENTRE, QUATERNION, SIZE = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("sx", "sy", "sz")
COLUMNS = ("time_s", "obj_id", *CENTRE, *QUATERNION, *SIZE)


class Boxes(NamedTuple):
    """Boxes of one vehicle over time, in a frame x east, y north, z up.

    Attributes:
        time_s: (n,) s, increasing.
        ground: (n, 3) m, where the upright axis of the box meets its lower side: the contact line.
        upright: (n, 3) unit vector of the upright axis, which leans with the vehicle.
    """

    time_s: Array
    ground: Array
    upright: Array


def read_boxes(path: Path, limits: RecordingLimits = USUAL) -> Boxes:
    """Boxes of the vehicle in one file.

    The files are in the frame of the sensor with y up; z, x and y become east, north and up, which
    keeps left turns left. The upright axis is the one of the box that is steepest over the file.
    Of several boxes at one time the first one of the file counts.

    Raises:
        TrackError: If the file is no table, lacks a column, a number is missing or beyond the
            limits, a box has no orientation, or fewer than `SAMPLES_NEEDED` times are left.
    """
    table = read_numbers(path, COLUMNS, path)
    table = table[table["obj_id"] == RIDER].sort_values("time_s", kind="stable")
    table = table.drop_duplicates("time_s")
    values = table[list(COLUMNS)].to_numpy(dtype=np.float64)
    broken = ~np.isfinite(values).all(axis=1)
    if broken.any() or len(values) == 0:
        found = "no row" if len(values) == 0 else values[int(broken.argmax())]
        needs = f"hold finite numbers with obj_id {RIDER}"
        refuse_track(RejectReason.NOT_FINITE, "rows", needs, found, path, "Copy the file again.")
    limits.check_samples(values[:, 0], table[list(CENTRE)].to_numpy(), path)
    if len(values) < SAMPLES_NEEDED:
        needs, found = f"hold {SAMPLES_NEEDED} frames at different times", f"{len(values)}"
        refuse_track(RejectReason.TOO_SHORT, "rows", needs, found, path, "Copy the file again.")
    length = np.linalg.norm(table[list(QUATERNION)].to_numpy(), axis=1)
    if not (np.abs(length - 1.0) < LENGTH_TOLERANCE).all():
        worst = int(np.abs(length - 1.0).argmax())
        found = f"length {length[worst]:g} at {values[worst, 0]:g} s"
        reason, needs = RejectReason.NO_ORIENTATION, "be quaternions of length 1"
        refuse_track(reason, "qx, qy, qz, qw", needs, found, path, "Copy the file again.")
    axes = Rotation.from_quat(table[list(QUATERNION)].to_numpy()).as_matrix()
    steepest = int(np.abs(axes[:, 1, :]).mean(axis=0).argmax())
    upright = axes[:, :, steepest] * np.sign(axes[:, 1, steepest])[:, None]
    height = table[SIZE[steepest]].to_numpy()
    ground = table[list(CENTRE)].to_numpy() - 0.5 * height[:, None] * upright
    to_world = [2, 0, 1]
    return Boxes(table["time_s"].to_numpy(), ground[:, to_world], upright[:, to_world])


def lean_to_the_left(upright: Array, velocity: Array) -> Array:
    """Lean (n,) in rad about the direction of travel, positive to the left.

    Args:
        upright: (n, 3) axis that leans with the vehicle.
        velocity: (n, 2) m/s; its direction is that of the wheels.
    """
    left = np.stack([-velocity[:, 1], velocity[:, 0]], axis=1)
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
    sideways = (upright[:, :2] * left).sum(axis=1)
    return direction(np.column_stack([upright[:, 2], sideways]))
