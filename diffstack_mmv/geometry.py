"""Angles, rotations, frames and distances in the plane, and the times of a path.

y is left of x, angles are counter-clockwise.

`root`, `length`, `unit_vector` and `distance_to_segment` are correctly rounded, whatever vector
library torch was built on: a benchmark case is decided by comparisons and goes on for a hundred
steps, so that an error of one unit in the last place may change its end. Products and sums are
exact to the digit everywhere; roots, cosines and sines of torch need not be.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.types import Discs, Motion, Obstacles

VARIANCE_FLOOR = 4e-4
"""m²: 2 cm, the noise that smoothing leaves on measured positions."""
SPLIT = 2.0**27 + 1
"""Splits a float64 number into two halves whose products are exact."""


def wrap_angle(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Map an angle in rad to [-π, π)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def direction(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b 2"]:
    """Return the unit vector (cos, sin) of an angle in rad."""
    return torch.stack([angle.cos(), angle.sin()], -1)


def angle_of(vector: Float[Tensor, "*b 2"], known: Bool[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Angle in rad of vectors from +x; zero, and without a slope, where it is not `known`.

    A vector of length zero has none, and the slope of the angle grows without bound near it.
    """
    x, y = vector.unbind(-1)
    one, zero = torch.ones_like(x), torch.zeros_like(y)
    return torch.atan2(torch.where(known, y, zero), torch.where(known, x, one))


def left_of(forward: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b 2"]:
    """The vector a quarter turn to the left."""
    return torch.stack([-forward[..., 1], forward[..., 0]], -1)


def rotate(vector: Float[Tensor, "*#b 2"], angle: Float[Tensor, "*#b"]) -> Float[Tensor, "*b 2"]:
    """Rotate vectors counter-clockwise by an angle in rad."""
    cosine, sine = angle.cos(), angle.sin()
    x, y = vector[..., 0], vector[..., 1]
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], -1)


def position_in_frame(
    position: Float[Tensor, "*#b 2"], origin: Float[Tensor, "*#b 2"], heading: Float[Tensor, "*#b"]
) -> Float[Tensor, "*b 2"]:
    """Express world positions in m in a frame with the given origin (m) and heading (rad)."""
    return rotate(position - origin, -heading)


def position_from_frame(
    position: Float[Tensor, "*b 2"], origin: Float[Tensor, "*#b 2"], heading: Float[Tensor, "*#b"]
) -> Float[Tensor, "*b 2"]:
    """Express positions in m of a frame with this origin (m) and heading (rad) in the world."""
    return rotate(position, heading) + origin


def distance_to_axis(
    position: Float[Tensor, "*#b 2"],
    origin: Float[Tensor, "*#b 2"],
    heading: Float[Tensor, "*#b"],
    rear: Float[Tensor, "*#b"],
    front: Float[Tensor, "*#b"],
    epsilon: float = 0.0,
) -> Float[Tensor, "*b"]:
    """Distance in m of points to a stretch of the axis of bodies at an origin with a heading.

    Args:
        position: Points in m.
        origin: Of the bodies, in m.
        heading: Of the bodies, in rad.
        rear: Where the stretch begins, in m ahead of the origin.
        front: Where it ends, not before it begins.
        epsilon: Added to the square in m², for a derivative at zero.
    """
    seen = position_in_frame(position, origin, heading)
    beyond = seen[..., 0] - torch.minimum(torch.maximum(seen[..., 0], rear), front)
    return (beyond.square() + seen[..., 1].square() + epsilon).sqrt()


def distance_to_outline(
    agents: Float[Tensor, "*#b N K T1 2"],
    position: Float[Tensor, "*#b T1 2"],
    heading: Float[Tensor, "*#b T1"],
    discs: Discs,
    epsilon: float = 0.0,
) -> Float[Tensor, "*b N K T1"]:
    """Distance in m of agents to the axis of a vehicle between its first and its last disc.

    Args:
        agents: Positions in m.
        position: Of the reference point of the vehicle at the same times, in m.
        heading: Of its body, in rad.
        discs: Around it; its outline is their hull.
        epsilon: See `distance_to_axis`.
    """
    return distance_to_axis(
        agents,
        position[..., None, None, :, :],
        heading[..., None, None, :],
        discs.ahead.amin(-1)[..., None, None, None],
        discs.ahead.amax(-1)[..., None, None, None],
        epsilon,
    )


def clearance_lack(
    motion: Motion, discs: Discs, obstacles: Obstacles, margin_m: float
) -> Float[Tensor, "*b N K T1"]:
    """How much a vehicle lacks in m of a margin to agents; negative where it keeps more.

    r_ego + r_i + margin - d_ikt, with the distance d of agent i in component k to the axis of the
    vehicle between its first and its last disc, smoothed at zero.

    Args:
        motion: Of the vehicle, `*b T1`; its heading is that of the body.
        discs: Around it, `*b D`; its outline is their hull.
        obstacles: Agents at the same times, `*b N K T1`, each with a disc; whether they are there
            is not asked.
        margin_m: Clearance between the outlines, in m.
    """
    distance = distance_to_outline(
        obstacles.position, motion.position, motion.heading, discs, epsilon=1e-6
    )
    reach = discs.radius.amax(-1)[..., None] + obstacles.radius + margin_m
    return reach[..., None, None] - distance


def motion_in_frame(
    motion: Motion, origin: Float[Tensor, "*#b 2"], heading: Float[Tensor, "*#b"]
) -> Motion:
    """Express a motion in a fixed frame; body velocity and yaw rate do not depend on it."""
    return motion._replace(
        position=position_in_frame(motion.position, origin, heading),
        heading=wrap_angle(motion.heading - heading),
    )


def motion_from_frame(
    motion: Motion, origin: Float[Tensor, "*#b 2"], heading: Float[Tensor, "*#b"]
) -> Motion:
    """Express a motion in a frame with this origin (m) and heading (rad) in the world."""
    return motion._replace(
        position=position_from_frame(motion.position, origin, heading),
        heading=wrap_angle(motion.heading + heading),
    )


def last_known(
    now: Float[Tensor, "*b 2"], position: Float[Tensor, "*b T 2"], valid: Bool[Tensor, "*b T"]
) -> Float[Tensor, "*b T 2"]:
    """Positions in m of who stays at the last valid one before a gap, at `now` if there is none."""
    number = torch.arange(1, valid.shape[-1] + 1, device=valid.device)
    latest = torch.where(valid, number, 0).cummax(-1).values
    path = torch.cat([now.unsqueeze(-2), position], -2)
    return path.take_along_dim(latest.unsqueeze(-1), -2)


def times_ahead(like: Tensor, steps: int, dt_s: float) -> Float[Tensor, " T"]:
    """Times in s from now to the end of each of so many steps, in type and place like a tensor."""
    return dt_s * torch.arange(1, steps + 1, dtype=like.dtype, device=like.device)


def shares_ahead(like: Tensor, steps: int) -> Float[Tensor, " T"]:
    """Part t / T of the way through so many steps at the end of each, as `times_ahead`."""
    return torch.arange(1, steps + 1, dtype=like.dtype, device=like.device) / steps


def between_rows(
    rows: Float[Tensor, "*b n c"], place: Float[Tensor, " k"]
) -> Float[Tensor, "*b k c"]:
    """Values at fractional rows; beyond the last row the last difference goes on."""
    if rows.shape[-2] == 1:
        return rows.expand(*rows.shape[:-2], len(place), rows.shape[-1])
    lower = place.floor().long().clamp(0, rows.shape[-2] - 2)
    share = (place - lower).to(rows).unsqueeze(-1)
    return rows[..., lower, :] + share * (rows[..., lower + 1, :] - rows[..., lower, :])


def root(square: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Correctly rounded square root, NaN below zero; its derivative at zero is told as zero.

    One Newton step in float64 with the residual x - s² computed without rounding error.

    Source:
        Dekker, A floating-point technique for extending the available precision (1971).
    """
    wide = square.double()
    wide = torch.where(wide == 0, torch.zeros_like(wide), wide)
    guess = torch.sqrt(wide)
    scaled = guess * SPLIT
    high = scaled - (scaled - guess)
    low = guess - high
    product = guess * guess
    error = ((high * high - product) + 2 * high * low) + low * low
    residual = (wide - product) - error
    refined = guess + residual / (2 * guess)
    return torch.where((guess > 0) & refined.isfinite(), refined, guess).to(square.dtype)


def length(vector: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b"]:
    """Length of a planar vector, in the unit of the vector."""
    x, y = vector.unbind(dim=-1)
    return root(x * x + y * y)


def unit_vector(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b 2"]:
    """The vector (cos, sin) of an angle in rad, with the accuracy of the C library."""
    return torch.view_as_real(torch.polar(torch.ones_like(angle), angle))


def distance_to_segment(
    start: Float[Tensor, "*b 2"], end: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b"]:
    """Distance in m of the origin to the segment from `start` to `end`, also if it is a point."""
    x, y = (end - start).unbind(dim=-1)
    squared = x * x + y * y
    # a segment without length would give 0/0; any point of it is the nearest
    apart = torch.where(squared > 0, squared, torch.ones_like(squared))
    along = ((-start[..., 0] * x + -start[..., 1] * y) / apart).clamp(0, 1)
    near_x, near_y = start[..., 0] + along * x, start[..., 1] + along * y
    return root(near_x * near_x + near_y * near_y)


def symmetric_root(scale_tril: Float[Tensor, "*b 2 2"]) -> Float[Tensor, "*b 2 2"]:
    """Root S = Sᵀ of the covariance L Lᵀ = S S, in closed form (Cayley and Hamilton).

    It turns with the frame, S of R Σ Rᵀ is R S Rᵀ, as no Cholesky factor does.
    """
    covariance = scale_tril @ scale_tril.mT
    determinant = scale_tril.diagonal(dim1=-2, dim2=-1).prod(-1)  # of S
    trace = (covariance.diagonal(dim1=-2, dim2=-1).sum(-1) + 2 * determinant).sqrt()  # of S
    identity = torch.eye(2, dtype=scale_tril.dtype, device=scale_tril.device)
    return (covariance + determinant[..., None, None] * identity) / trace[..., None, None]


def scale_from_covariance(
    covariance: Float[Tensor, "*b 2 2"], floor: float = VARIANCE_FLOOR
) -> Float[Tensor, "*b 2 2"]:
    """Lower Cholesky factor in m of a covariance in m², with `floor` in m² on its diagonal."""
    first = (covariance[..., 0, 0] + floor).sqrt()
    cross = covariance[..., 1, 0] / first
    # exact arithmetic leaves at least `floor` here; rounding may not
    second = (covariance[..., 1, 1] + floor - cross.square()).clamp_min(0.5 * floor).sqrt()
    top = torch.stack([first, torch.zeros_like(first)], -1)
    return torch.stack([top, torch.stack([cross, second], -1)], -2)


def solve_symmetric(
    matrix: Float[Tensor, "*b 2 2"], vector: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b 2"]:
    """S⁻¹ v of a symmetric matrix S that is not singular, by its adjugate."""
    first, cross, second = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]
    x, y = vector.unbind(-1)
    solved = torch.stack([second * x - cross * y, first * y - cross * x], -1)
    return solved / (first * second - cross.square()).unsqueeze(-1)
