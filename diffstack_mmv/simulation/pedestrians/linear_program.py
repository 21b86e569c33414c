"""The three small linear programs of ORCA, for a batch of agents at once.

The optimum on one line does not depend on the optimum found so far, hence all lines of all agents
are solved in one go and only the walk along the lines remains a loop.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.geometry import root
from diffstack_mmv.simulation.pedestrians.half_planes import HalfPlanes, det, dot, normalise

PARALLEL = 1e-5
"""Lines count as parallel where the determinant of their directions is at most this."""


class LineInterval(NamedTuple):
    """Permitted part of each line, point + t direction with t from `left` to `right` in m/s."""

    left: Float[Tensor, "*b k"]
    right: Float[Tensor, "*b k"]
    feasible: Bool[Tensor, "*b k"]


class Optimum(NamedTuple):
    """Velocity in m/s and the first line that could not be satisfied, k where all could."""

    velocity: Float[Tensor, "*b 2"]
    failed_line: Int[Tensor, "*b"]


def safest_velocity(
    planes: HalfPlanes, max_speed: Float[Tensor, "*b"], preferred: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b 2"]:
    """Permitted velocity nearest to the preferred one; if none is permitted, the least unsafe one.

    Args:
        planes: Half-planes, `*b k`, in order of importance.
        max_speed: Largest speed in m/s.
        preferred: Preferred velocity in m/s.

    Returns:
        Velocity in m/s.
    """
    return least_violation(planes, max_speed, nearest_velocity(planes, max_speed, preferred))


def nearest_velocity(
    planes: HalfPlanes, max_speed: Float[Tensor, "*b"], preferred: Float[Tensor, "*b 2"]
) -> Optimum:
    """Two-dimensional program: minimise |v - preferred| within all half-planes and the speed disc.

    Args:
        planes: Half-planes, `*b k`.
        max_speed: Largest speed in m/s.
        preferred: Preferred velocity in m/s.

    Returns:
        The optimum, or the last feasible velocity and the line that made the program infeasible.
    """
    interval = feasible_interval(planes, max_speed)
    along = dot(planes.direction, preferred[..., None, :] - planes.point)
    along = torch.where(
        along < interval.left,
        interval.left,
        torch.where(along > interval.right, interval.right, along),
    )
    too_fast = dot(preferred, preferred) > max_speed * max_speed
    limited = normalise(preferred) * max_speed[..., None]
    return _walk(planes, interval, along, torch.where(too_fast[..., None], limited, preferred))


def furthest_velocity(
    planes: HalfPlanes, max_speed: Float[Tensor, "*b"], direction: Float[Tensor, "*b 2"]
) -> Optimum:
    """Two-dimensional program: go as far as possible along `direction` within all half-planes.

    Args:
        planes: Half-planes, `*b k`.
        max_speed: Largest speed in m/s.
        direction: Unit vector.

    Returns:
        The optimum as in `nearest_velocity`.
    """
    interval = feasible_interval(planes, max_speed)
    forward = dot(direction[..., None, :], planes.direction) > 0
    along = torch.where(forward, interval.right, interval.left)
    return _walk(planes, interval, along, direction * max_speed[..., None])


def feasible_interval(planes: HalfPlanes, max_speed: Float[Tensor, "*b"]) -> LineInterval:
    """Part of each line inside the speed disc and inside the half-planes before it.

    A comparison with NaN is false, so a degenerate half-plane restricts nothing.

    Args:
        planes: Half-planes, `*b k`.
        max_speed: Radius of the disc in m/s.

    Returns:
        The interval of each line, `*b k`.
    """
    middle = -dot(planes.point, planes.direction)
    reach = (max_speed * max_speed)[..., None]
    discriminant = middle * middle + reach - dot(planes.point, planes.point)
    half = root(discriminant)
    this, that = planes.direction[..., :, None, :], planes.direction[..., None, :, :]
    offset = planes.point[..., :, None, :] - planes.point[..., None, :, :]
    denominator, numerator = det(this, that), det(that, offset)
    lines = planes.point.shape[-2]
    earlier = torch.ones(lines, lines, dtype=torch.bool, device=offset.device).tril(diagonal=-1)
    earlier = earlier & planes.valid[..., None, :]
    parallel = denominator.abs() <= PARALLEL
    crossing = numerator / denominator
    usable = earlier & ~parallel & ~crossing.isnan()
    left, right = middle - half, middle + half
    if lines:
        upper = torch.where(usable & (denominator >= 0), crossing, torch.inf).amin(dim=-1)
        lower = torch.where(usable & ~(denominator >= 0), crossing, -torch.inf).amax(dim=-1)
        left, right = torch.maximum(left, lower), torch.minimum(right, upper)
    shut_out = (earlier & parallel & (numerator < 0)).any(dim=-1)
    return LineInterval(left, right, ~((discriminant < 0) | (left > right) | shut_out))


def _walk(
    planes: HalfPlanes,
    interval: LineInterval,
    along: Float[Tensor, "*b k"],
    start: Float[Tensor, "*b 2"],
) -> Optimum:
    """Visit the lines in order and move to the optimum on each one that is violated."""
    lines = planes.point.shape[-2]
    optimum = planes.point + along[..., None] * planes.direction
    velocity = start
    failed = torch.full(start.shape[:-1], lines, dtype=torch.int64, device=start.device)
    for line in range(lines):
        violated = det(planes.direction[..., line, :], planes.point[..., line, :] - velocity) > 0
        violated = violated & planes.valid[..., line] & (failed == lines)
        feasible = interval.feasible[..., line]
        velocity = torch.where((violated & feasible)[..., None], optimum[..., line, :], velocity)
        failed = torch.where(violated & ~feasible, line, failed)
    return Optimum(velocity, failed)


def least_violation(
    planes: HalfPlanes, max_speed: Float[Tensor, "*b"], found: Optimum
) -> Float[Tensor, "*b 2"]:
    """Three-dimensional program: the velocity that violates the worst half-plane least.

    Args:
        planes: Half-planes, `*b k`.
        max_speed: Largest speed in m/s.
        found: Outcome of the two-dimensional program, where it failed the start of this one.

    Returns:
        Velocity in m/s; that of `found` where it had not failed.
    """
    lines = planes.point.shape[-2]
    velocity = found.velocity.clone()
    violation = torch.zeros_like(max_speed)
    for line in range(lines):
        point, direction = planes.point[..., line, :], planes.direction[..., line, :]
        worse = det(direction, point - velocity) > violation
        worse = worse & planes.valid[..., line] & (found.failed_line <= line)
        if not bool(worse.any()):
            continue
        subset = HalfPlanes(*(field[worse] for field in planes))
        improved = _least_violation_of(subset, line, max_speed[worse])
        kept = (improved.failed_line < line)[..., None]
        velocity[worse] = torch.where(kept, velocity[worse], improved.velocity)
        violation = torch.where(worse, det(direction, point - velocity), violation)
    return velocity


def _least_violation_of(planes: HalfPlanes, line: int, max_speed: Float[Tensor, " b"]) -> Optimum:
    """Program on `line`, where the earlier lines are those of equal violation with it."""
    this = planes.direction[:, line, None, :]
    point = planes.point[:, line, None, :]
    that, other_point = planes.direction[:, :line], planes.point[:, :line]
    determinant = det(this, that)
    parallel = determinant.abs() <= PARALLEL
    shift = det(that, point - other_point) / determinant
    crossing = point + shift[..., None] * this
    projected = HalfPlanes(
        point=torch.where(parallel[..., None], 0.5 * (point + other_point), crossing),
        direction=normalise(that - this),
        valid=planes.valid[:, :line] & ~(parallel & (dot(this, that) > 0)),
    )
    inward = torch.stack((-this[:, 0, 1], this[:, 0, 0]), dim=-1)
    return furthest_velocity(projected, max_speed, inward)
