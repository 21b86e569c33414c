"""Estimates of an agent's present motion from its track, robust to missing rows.

Measured velocities at the end of a track are the noisiest of all, since no later sample supports
them; the estimates here therefore come from positions.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import angle_of, direction, rotate
from diffstack_mmv.smooth import safe_norm, soft_clamp
from diffstack_mmv.types import Motion, Tracks

# weights of the prior of position, velocity and acceleration in units of one present row; they
# decide only where rows are missing
_PRIOR = (0.01, 0.001, 0.0001)


MEMORY_S = 0.7
"""Of the fit to a track, the best one on cyclists."""
SLOW_MPS = 0.3
"""Speed below which the course is not observable."""
_COURSE_MPS = 0.05  # below, the derivative of a course grows without bound


class Trend(NamedTuple):
    """Where an agent is and how it moves now by a fit, in the frame of its positions."""

    offset: Float[Tensor, "*b 2"]  # m, of the fit from the last position
    velocity: Float[Tensor, "*b 2"]  # m/s
    acceleration: Float[Tensor, "*b 2"]  # m/s²


def current_position(tracks: Tracks) -> Float[Tensor, "*b 2"]:
    """Position in m at the last row, the origin for an agent that is not observed there."""
    position = tracks.motion.position[..., -1, :]
    return torch.where(tracks.valid[..., -1:], position, torch.zeros_like(position))


def current_heading(tracks: Tracks) -> Float[Tensor, "*b"]:
    """Heading in rad at the last row, zero for an agent that is not observed there."""
    heading = tracks.motion.heading[..., -1]
    return torch.where(tracks.valid[..., -1], heading, torch.zeros_like(heading))


def current_velocity(tracks: Tracks) -> Float[Tensor, "*b 2"]:
    """Measured velocity in m/s at the last row, in the frame of the positions, else zero."""
    velocity = rotate(tracks.motion.velocity[..., -1, :], tracks.motion.heading[..., -1])
    return torch.where(tracks.valid[..., -1:], velocity, torch.zeros_like(velocity))


def mean_velocity(tracks: Tracks, rows: int, dt_s: float) -> Float[Tensor, "*b 2"]:
    """Way from the first valid row of a window to the last row over the time it took, in m/s.

    An agent with no other valid row within the last `rows` steps has its measured velocity.
    """
    valid = tracks.valid[..., -1 - rows :]
    steps_back = torch.arange(valid.shape[-1] - 1, -1, -1, device=valid.device)
    first = torch.where(valid, steps_back, torch.zeros_like(steps_back)).amax(-1, keepdim=True)
    recent = tracks.motion.position[..., -1 - rows :, :]
    start = recent.take_along_dim((valid.shape[-1] - 1 - first).unsqueeze(-1), -2).squeeze(-2)
    way = current_position(tracks) - start
    observed = (first > 0) & tracks.valid[..., -1:]
    return torch.where(observed, way / (first.clamp_min(1) * dt_s), current_velocity(tracks))


def steady_path(
    tracks: Tracks, time: Float[Tensor, " T"], rows: int, dt_s: float
) -> Float[Tensor, "*b T 2"]:
    """Positions in m at times in s after the last row, at the `mean_velocity` of `rows` steps."""
    velocity = mean_velocity(tracks, rows, dt_s)
    return current_position(tracks).unsqueeze(-2) + time.unsqueeze(-1) * velocity.unsqueeze(-2)


def trend(tracks: Tracks, memory_s: float, dt_s: float) -> Trend:
    """Velocity and acceleration at the last row, from a parabola with fading memory.

    Least squares over the valid positions with the weights exp(-age / memory), and a slight pull to
    the measured velocity and to zero acceleration, which decides for an agent with fewer than three
    rows.
    """
    return trends(tracks, (memory_s,), dt_s)[0]


def trends(tracks: Tracks, memories_s: Sequence[float], dt_s: float) -> list[Trend]:
    """`trend` with each of several memories."""
    valid = tracks.valid & tracks.valid[..., -1:]
    offset = tracks.motion.position - current_position(tracks).unsqueeze(-2)
    # in double precision: the powers of seconds make the equations badly conditioned, and in single
    # precision an agent's fit would depend on its batch mates in the fifth digit
    offset = torch.where(valid.unsqueeze(-1), offset, torch.zeros_like(offset)).double()
    rows = valid.shape[-1]
    time = dt_s * torch.arange(1 - rows, 1, device=offset.device, dtype=offset.dtype)
    powers = torch.stack([torch.ones_like(time), time, 0.5 * time.square()], -1)
    products = (powers.unsqueeze(-1) * powers.unsqueeze(-2)).flatten(-2)
    pull = torch.diag(torch.cat([time.new_full((1,), weight) for weight in _PRIOR]))
    prior = torch.stack(
        [
            torch.zeros_like(offset[..., 0, :]),
            current_velocity(tracks).double(),
            torch.zeros_like(offset[..., 0, :]),
        ],
        -2,
    )
    ages = torch.stack([time / memory_s for memory_s in memories_s])  # constants on the device
    fading = torch.exp(ages).unsqueeze(-1)
    known = valid.to(offset.dtype)
    matrix = _each_memory(known, fading * products).unflatten(-1, (3, 3)) + pull
    sums = _each_memory(offset.mT.contiguous(), fading * powers)  # zero where not valid
    # without the check for singular matrices, which waits for a GPU: the pull prevents them
    solution = torch.linalg.solve_ex(matrix, sums.mT + pull @ prior).result
    solution = solution.to(tracks.motion.position.dtype)
    return [Trend(*each.unbind(-2)) for each in solution]


def _each_memory(
    rows: Float[Tensor, "*b T"], weights: Float[Tensor, "M T p"]
) -> Float[Tensor, "M *b p"]:
    """Sums of rows over time with the weights of each memory, in one product."""
    columns = weights.movedim(0, 1).flatten(1)
    return (rows @ columns).unflatten(-1, (len(weights), -1)).movedim(-2, 0)


def rest(tracks: Tracks, memory_s: float, reach_m: float, dt_s: float) -> Trend:
    """An agent that stands, and the noise of its track: the mean position with fading memory.

    That mean is at most `reach_m` away from the last position, since whoever moves is not there.
    """
    valid = tracks.valid & tracks.valid[..., -1:]
    rows = valid.shape[-1]
    offset = tracks.motion.position - current_position(tracks).unsqueeze(-2)
    age = dt_s * torch.arange(rows - 1, -1, -1, dtype=offset.dtype, device=offset.device)
    weight = (torch.exp(-age / memory_s) * valid).unsqueeze(-1)
    offset = torch.where(valid.unsqueeze(-1), offset, torch.zeros_like(offset))
    mean = (weight * offset).sum(-2) / weight.sum(-2).clamp_min(_PRIOR[0])
    away = safe_norm(mean).unsqueeze(-1)
    mean = mean * (soft_clamp(away, reach_m) / away)
    return Trend(mean, torch.zeros_like(mean), torch.zeros_like(mean))


def current_course(
    velocity: Float[Tensor, "*b 2"], heading: Float[Tensor, "*b"]
) -> Float[Tensor, "*b"]:
    """Direction in rad of a fitted velocity in m/s, and below walking speed that of the track.

    At rest the course is not observable; between both it turns smoothly. Whoever rolls backwards
    slowly is on no course that could be learned from: there the gradient is zero.
    """
    slow = SLOW_MPS * torch.exp(-safe_norm(velocity)).unsqueeze(-1)
    ahead = velocity + slow * direction(heading)
    known = ahead.norm(dim=-1, keepdim=True) > _COURSE_MPS
    ahead = torch.where(known, ahead, ahead.detach())
    return torch.atan2(ahead[..., 1], ahead[..., 0])


def motion_along(path: Float[Tensor, "*b T 2"], tracks: Tracks, dt_s: float) -> Motion:
    """Motion at the last row, `*b`, with which a predicted path (m) begins.

    Position and velocity are extrapolated from its first two positions: a predictor has weighed
    what it observed, while the last row has the noise of a single measurement, from which a vehicle
    that cannot go sideways would not get away within the horizon.

    Whoever moves is on the course of that velocity; below walking speed the heading of the track
    holds, as the course is not observable.
    """
    if path.shape[-2] == 1:  # nothing to extrapolate from
        start = current_position(tracks)
        velocity = (path[..., 0, :] - start) / dt_s
    else:
        velocity = (path[..., 1, :] - path[..., 0, :]) / dt_s
        start = path[..., 0, :] - dt_s * velocity
    speed = safe_norm(velocity)
    moves = speed >= SLOW_MPS
    heading = torch.where(moves, angle_of(velocity, moves), current_heading(tracks))
    ahead = torch.stack([speed, torch.zeros_like(speed)], -1)
    return Motion(start, heading, ahead, torch.zeros_like(speed))
