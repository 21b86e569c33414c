"""The scene of a case in a recorded crowd: where everybody starts, and goes."""

import numpy as np
import torch
from numpy.typing import NDArray

from diffstack_mmv.simulation.pedestrians import RecordedCrowdState
from diffstack_mmv.simulation.pedestrians.recorded import far_away
from diffstack_mmv.simulation.recorded.crossing import RecordedRows
from diffstack_mmv.simulation.scene import Scene

USUAL_RADIUS_M = 0.3
"""Radius of an agent that is not there, and of one in a picture."""
SLOWEST_MPS = 0.1
"""The preferred speed of nobody is smaller."""


def case_scene(rows: RecordedRows, lead: int, step_s: float, way_m: float, room: int) -> Scene:
    """The scene of a case, padded to the largest number of agents.

    Args:
        rows: The agents in the frame of the way: it leads along y, through the origin.
        lead: Row of the start; those before it have been seen.
        step_s: From one row to the next.
        way_m: Length of the way of the vehicle.
        room: Largest number of agents.
    """
    count, steps = rows.inside.shape
    track = np.zeros((room, steps, 2))
    inside = np.zeros((room, steps), dtype=bool)
    track[:count], inside[:count] = rows.position, rows.inside
    sizes = np.full(room, USUAL_RADIUS_M)
    sizes[:count] = rows.radius
    position, present = _as_tensor(track[:, lead]), torch.from_numpy(inside[:, lead])[:, None]
    velocity = _as_tensor(track[:, lead] - track[:, lead - 1]) / step_s
    last = np.where(inside.any(-1), steps - 1 - inside[:, ::-1].argmax(-1), 0)
    moved = np.linalg.norm(np.diff(track, axis=1), axis=-1) * inside[:, 1:]
    speed = moved.sum(-1) / np.maximum(inside[:, 1:].sum(-1), 1) / step_s
    half = torch.tensor([0.0, way_m / 2], dtype=torch.float64)
    return Scene(
        robot_position=-half,
        robot_heading=half.new_tensor(np.pi / 2),
        robot_goal=half,
        pedestrians=RecordedCrowdState(
            position=torch.where(present, position, far_away(position)),
            velocity=torch.where(present, velocity, torch.zeros_like(velocity)),
            goal=_as_tensor(track[np.arange(room), last]),
            radius=_as_tensor(sizes),
            preferred_speed=_as_tensor(np.maximum(speed, SLOWEST_MPS)),
            track=_as_tensor(track),
            inside=torch.from_numpy(inside),
            row=torch.tensor(lead),
            lead=torch.tensor(lead),
            step_s=half.new_tensor(step_s),
        ),
    )


def _as_tensor(array: NDArray[np.float64]) -> torch.Tensor:
    """A tensor with memory of its own."""
    return torch.from_numpy(np.ascontiguousarray(array))
