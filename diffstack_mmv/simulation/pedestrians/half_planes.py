"""ORCA half-planes of permitted velocities, one per neighbor, for any batch of agents.

The arithmetic is that of the RVO2 library, operation by operation: each product and each sum is
rounded on its own and a division by a scalar is a product with its reciprocal. In float32 the
results are therefore identical, to the last bit, with those of the library.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.geometry import root


class Agents(NamedTuple):
    """Agents that choose a velocity; lengths in m, speeds in m/s, world frame."""

    position: Float[Tensor, "*b 2"]
    velocity: Float[Tensor, "*b 2"]
    preferred_velocity: Float[Tensor, "*b 2"]
    radius: Float[Tensor, "*b"]
    max_speed: Float[Tensor, "*b"]


class Neighbors(NamedTuple):
    """What each agent sees of the neighbors; m and m/s, `valid` where there is somebody."""

    position: Float[Tensor, "*b k 2"]
    velocity: Float[Tensor, "*b k 2"]
    radius: Float[Tensor, "*b k"]
    valid: Bool[Tensor, "*b k"]


class HalfPlanes(NamedTuple):
    """Permitted velocities lie to the left of the line through `point` (m/s) along `direction`."""

    point: Float[Tensor, "*b k 2"]
    direction: Float[Tensor, "*b k 2"]
    valid: Bool[Tensor, "*b k"]


class Nearest(NamedTuple):
    """Neighbors sorted by distance, and the column from which each one came."""

    neighbors: Neighbors
    index: Int[Tensor, "*b k"]


def dot(first: Float[Tensor, "*#b 2"], second: Float[Tensor, "*#b 2"]) -> Float[Tensor, "..."]:
    """Scalar product over the last axis, summed from the left without fused operations."""
    return first[..., 0] * second[..., 0] + first[..., 1] * second[..., 1]


def det(first: Float[Tensor, "*#b 2"], second: Float[Tensor, "*#b 2"]) -> Float[Tensor, "..."]:
    """Determinant of two planar vectors: positive where `second` lies to the left of `first`."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def normalise(vector: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b 2"]:
    """Unit vector, NaN for the zero vector: a half-plane of NaN forbids nothing."""
    return vector * torch.reciprocal(root(dot(vector, vector)))[..., None]


def nearest(
    agents: Agents,
    neighbors: Neighbors,
    distance: Float[Tensor, "*#b"],
    count: Int[Tensor, "*#b"],
) -> Nearest:
    """The `count` nearest neighbors closer than `distance` (m), equal distances in given order.

    Args:
        agents: Agents, `*b`.
        neighbors: All candidates of each agent, `*b k`.
        distance: Range of sight in m.
        count: Largest number of neighbors.

    Returns:
        Neighbors sorted by distance, at most the largest `count` columns.
    """
    offset = agents.position[..., None, :] - neighbors.position
    squared = dot(offset, offset)
    seen = neighbors.valid & (squared < (distance * distance)[..., None])
    order = torch.sort(torch.where(seen, squared, torch.inf), dim=-1, stable=True).indices
    order = order[..., : int(count.max())]
    rank = torch.arange(order.shape[-1], device=order.device)
    sorted_others = Neighbors(
        position=torch.take_along_dim(neighbors.position, order[..., None], dim=-2),
        velocity=torch.take_along_dim(neighbors.velocity, order[..., None], dim=-2),
        radius=torch.take_along_dim(neighbors.radius, order, dim=-1),
        valid=torch.take_along_dim(seen, order, dim=-1) & (rank < count[..., None]),
    )
    return Nearest(sorted_others, order)


def half_planes(
    agents: Agents,
    neighbors: Neighbors,
    time_step: Float[Tensor, "*#b"],
    time_horizon: Float[Tensor, "*#b"],
) -> HalfPlanes:
    """The half-plane that each neighbor leaves, if both take half of the avoidance.

    The velocity obstacle of a pair at distance p with summed radius R and relative velocity v is
    truncated at p/T; u leads from v to its nearest boundary point and the line passes through
    the agent's velocity + u/2. Overlapping pairs use the time step in place of the horizon T.

    Args:
        agents: Agents, `*b`.
        neighbors: Their neighbors, `*b k`.
        time_step: Time in s within which an overlap is left.
        time_horizon: Time T in s for which the velocity is to be free of collision.

    Returns:
        One half-plane per neighbor, NaN for a degenerate pair.

    Source:
        van den Berg et al., Reciprocal n-Body Collision Avoidance, Sec. 4-5.
    """
    offset = neighbors.position - agents.position[..., None, :]
    relative = agents.velocity[..., None, :] - neighbors.velocity
    radius = agents.radius[..., None] + neighbors.radius
    apart = dot(offset, offset) > radius * radius
    rate = torch.where(
        apart, torch.reciprocal(time_horizon)[..., None], torch.reciprocal(time_step)[..., None]
    )
    cut = _cut_off_circle(offset, relative, radius, rate)
    leg = _legs(offset, relative, radius, cut.from_centre)
    on_circle = ~apart | cut.nearest
    direction = torch.where(on_circle[..., None], cut.direction, leg.direction)
    change = torch.where(on_circle[..., None], cut.change, leg.change)
    return HalfPlanes(agents.velocity[..., None, :] + 0.5 * change, direction, neighbors.valid)


class _Boundary(NamedTuple):
    direction: Float[Tensor, "*b 2"]
    change: Float[Tensor, "*b 2"]


class _CutOff(NamedTuple):
    direction: Float[Tensor, "*b 2"]
    change: Float[Tensor, "*b 2"]
    from_centre: Float[Tensor, "*b 2"]
    nearest: Bool[Tensor, "*b"]


def _cut_off_circle(
    offset: Float[Tensor, "*b 2"],
    relative: Float[Tensor, "*b 2"],
    radius: Float[Tensor, "*b"],
    rate: Float[Tensor, "*b"],
) -> _CutOff:
    """Boundary point on the circle that truncates the velocity obstacle."""
    from_centre = relative - rate[..., None] * offset
    squared = dot(from_centre, from_centre)
    ahead = dot(from_centre, offset)
    length = root(squared)
    unit = from_centre * torch.reciprocal(length)[..., None]
    return _CutOff(
        direction=torch.stack((unit[..., 1], -unit[..., 0]), dim=-1),
        change=(radius * rate - length)[..., None] * unit,
        from_centre=from_centre,
        nearest=(ahead < 0) & (ahead * ahead > radius * radius * squared),
    )


def _legs(
    offset: Float[Tensor, "*b 2"],
    relative: Float[Tensor, "*b 2"],
    radius: Float[Tensor, "*b"],
    from_centre: Float[Tensor, "*b 2"],
) -> _Boundary:
    """Boundary point on the left or right tangent of the velocity obstacle."""
    squared = dot(offset, offset)
    length = root(squared - radius * radius)
    x, y = offset.unbind(dim=-1)
    left = torch.stack((x * length - y * radius, x * radius + y * length), dim=-1)
    right = -torch.stack((x * length + y * radius, -x * radius + y * length), dim=-1)
    side = torch.where((det(offset, from_centre) > 0)[..., None], left, right)
    direction = side * torch.reciprocal(squared)[..., None]
    return _Boundary(direction, dot(relative, direction)[..., None] * direction - relative)
