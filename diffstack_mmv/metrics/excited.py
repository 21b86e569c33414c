"""How hard the human rides over a window: what tells one vehicle model from another."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.types import StackBatch

CHORD_S = 0.5  # s; over shorter times the noise of the positions would count as acceleration
SLOWEST_MPS = 0.5  # m/s, below which a lateral acceleration has no direction


class Excited(NamedTuple):
    """A quantity by which errors are told, and the ranges of their table."""

    name: str
    heading: str
    edges: tuple[float, ...]


SPEED, LATERAL = "human_speed_mps", "human_lateral_mps2"
EXCITATION = (
    Excited(LATERAL, "lateral acceleration [m/s²]", (0.0, 0.5, 1.0, 2.0, 3.0, math.inf)),
    Excited(SPEED, "speed [m/s]", (0.0, 2.0, 4.0, 6.0, 8.0, math.inf)),
)


def excitation(batch: StackBatch) -> dict[str, Float[Tensor, " B"]]:
    """Largest speed (m/s) and lateral acceleration (m/s²) of the human over the horizon.

    Both come from chords of half a second of the recorded positions, the present included. Zero
    where the human was recorded for too short a time.
    """
    now = batch.ego_past.motion.position[:, -1:]
    position = torch.cat([now, batch.ego_future.motion.position], 1)
    known = torch.cat([batch.ego_past.valid[:, -1:], batch.ego_future.valid], 1)
    step = max(round(CHORD_S / batch.dt_s), 1)
    position, known = position[:, ::step], known[:, ::step]
    interval_s = step * batch.dt_s
    velocity = position.diff(dim=1) / interval_s
    moving = known[:, 1:] & known[:, :-1]
    speed = velocity.norm(dim=-1)
    change = velocity.diff(dim=1) / interval_s
    twice = velocity[:, :-1] + velocity[:, 1:]
    along = twice / twice.norm(dim=-1, keepdim=True).clamp_min(2 * SLOWEST_MPS)
    lateral = (along[..., 0] * change[..., 1] - along[..., 1] * change[..., 0]).abs()
    return {
        SPEED: _largest(speed, moving),
        LATERAL: _largest(lateral, moving[:, 1:] & moving[:, :-1]),
    }


def _largest(value: Float[Tensor, "B T"], known: Bool[Tensor, "B T"]) -> Float[Tensor, " B"]:
    padded = torch.nn.functional.pad(torch.where(known, value, 0.0), (0, 1))
    return padded.amax(-1)
