"""Planning problems from observed agents and their forecasts: the one way to build one."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import angle_of, last_known, shares_ahead
from diffstack_mmv.types import (
    Discs,
    Ego,
    Forecast,
    HeadingOf,
    Motion,
    Obstacles,
    PlanningProblem,
    Tracks,
    on_host,
    taken,
)

SLOW_MPS = 0.3
NEAR_M = 1.0


class Reference(NamedTuple):
    """Where and how fast the ego would go if nothing were in its way."""

    path: Float[Tensor, "*b T1 2"]  # m, row 0 is now
    speed: Float[Tensor, "*b"]  # m/s


def build_problem(
    ego: Ego, goal: Float[Tensor, "*b 2"], reference: Reference, obstacles: Obstacles
) -> PlanningProblem:
    """Planning problem of an ego with a goal in m, a reference and predicted agents.

    Training and simulation build their problems here; they differ in where the parts come from.
    """
    return PlanningProblem(ego, goal, reference.path, reference.speed, obstacles)


def initial_state(dynamics: DynamicsModel, ego: Ego) -> Float[Tensor, "*b n"]:
    """State of a model in which a plan begins, whatever the observed heading is that of."""
    if ego.heading_of is HeadingOf.COURSE:
        return dynamics.state_on_course(ego.motion)
    return dynamics.initial_state(ego.motion)


def tracked_ego(motion: Motion, extent: Float[Tensor, "*b 2"], goal: Float[Tensor, "*b 2"]) -> Ego:
    """The ego at the end of its track, whose heading is its course.

    The heading of a rider at rest is not observed: it then faces the goal.

    Args:
        motion: How it moves now, *b.
        extent: Length and width in m.
        goal: In m.
    """
    return Ego(facing_the_goal(motion, goal), HeadingOf.COURSE, end_discs(extent))


def end_discs(extent: Float[Tensor, "*b 2"]) -> Discs:
    """Two discs at the ends of a (length, width) box in m: their hull is as long and as wide.

    The hull has round ends, as two-wheelers do. What is wider than long is one disc.
    """
    length, width = extent.unbind(-1)
    reach = 0.5 * (length - width).clamp_min(0)
    return Discs(torch.stack([-reach, reach], -1), 0.5 * width[..., None].expand(extent.shape))


def facing_the_goal(motion: Motion, goal: Float[Tensor, "*b 2"]) -> Motion:
    """Turn whoever is slower than 0.3 m/s towards a goal (m) that is further than 1 m away."""
    offset = goal - motion.position
    unknown = (motion.velocity.norm(dim=-1) < SLOW_MPS) & (offset.norm(dim=-1) > NEAR_M)
    towards = angle_of(offset, unknown)
    return motion._replace(heading=torch.where(unknown, towards, motion.heading))


def disc_radius(extent: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b"]:
    """Radius in m of the disc with the area of a (length, width) box in m.

    Between its half width and half length.
    """
    return (extent.prod(-1) / torch.pi).sqrt()


def predicted_obstacles(
    position: Float[Tensor, "*b N 2"],
    radius: Float[Tensor, "*b N"],
    valid: Bool[Tensor, "*b N"],
    forecast: Forecast,
) -> Obstacles:
    """Obstacles from the predictions of the other agents.

    Args:
        position: Where the agents are now, m.
        radius: Of the disc around each, m.
        valid: Which agents are observed now.
        forecast: Their forecast, *b N K T; thin it out beforehand, the cost of planning grows with
            K.
    """
    now = position[..., None, None, :].expand_as(forecast.mean[..., :1, :])
    return Obstacles(
        position=torch.cat([now, forecast.mean], -2),
        weight=forecast.log_weight.exp(),
        radius=radius,
        valid=valid,
    )


def likeliest(obstacles: Obstacles) -> Obstacles:
    """The agents with the likeliest component of each alone, of weight one."""
    best = obstacles.weight.argmax(-1, keepdim=True)
    position = taken(obstacles.position, best)
    return obstacles._replace(position=position, weight=torch.ones_like(obstacles.weight[..., :1]))


def possible(obstacles: Obstacles) -> Obstacles:
    """The components of each problem that are possible, each as an agent of its own.

    Scores, and costs that say so (`adds_components`), add up or compare components of agents and
    agents in one way, so nothing else changes. Problems with fewer than the others get absent
    ones. On a device all are kept: to count them the host would have to wait.

    Args:
        obstacles: Agents of the shape `b N K`, with one leading dimension.
    """
    if not on_host(obstacles.weight):
        return obstacles
    there = (obstacles.valid[..., None] & (obstacles.weight > 0)).flatten(1)
    most = int(there.sum(-1).max()) if there.numel() else 0
    if most == there.shape[-1] or not most:
        return obstacles
    order = (~there).long().argsort(dim=-1, stable=True)[:, :most]
    weight = obstacles.weight.flatten(1).gather(1, order)
    radius = obstacles.radius[..., None].expand_as(obstacles.weight).flatten(1)
    return Obstacles(
        position=obstacles.position.flatten(1, 2)
        .take_along_dim(order[..., None, None], 1)
        .unsqueeze(2),
        weight=weight.unsqueeze(-1),
        radius=radius.gather(1, order),
        valid=there.gather(1, order),
    )


def filled_up(obstacles: Obstacles) -> Obstacles:
    """The agents, with absent ones up to 4, 8, 16, ...: batches then have few shapes to compile."""
    count = obstacles.valid.shape[-1]
    missing = (max(4, 1 << (count - 1).bit_length()) if count else 0) - count
    if missing == 0:
        return obstacles
    batch, (_, *rest) = obstacles.valid.shape[:-1], obstacles.position.shape[-4:]
    absent = Obstacles(
        obstacles.position.new_zeros(*batch, missing, *rest),
        obstacles.weight.new_zeros(*batch, missing, rest[0]),
        obstacles.radius.new_zeros(*batch, missing),
        obstacles.valid.new_zeros(*batch, missing),
    )
    dims = -4, -2, -1, -1
    return Obstacles(
        *(torch.cat(pair, dim) for *pair, dim in zip(obstacles, absent, dims, strict=True))
    )


def observed_obstacles(past: Tracks, future: Tracks) -> Obstacles:
    """Obstacles whose future is known, for costs in hindsight.

    One component, which stays at the last position seen where the track ends.

    Args:
        past: Tracks of shape (*b, N, H), whose last row is now.
        future: What follows, of shape (*b, N, T).
    """
    now = past.present()
    start = now.motion.position
    seen = last_known(start, future.motion.position, future.valid)
    path = torch.cat([start.unsqueeze(-2), seen], -2).unsqueeze(-3)
    return Obstacles(
        position=path,
        weight=torch.ones_like(path[..., 0, 0]),
        radius=disc_radius(past.extent),
        valid=now.valid,
    )


def straight_reference(
    motion: Motion, goal: Float[Tensor, "*b 2"], steps: int, speed_mps: float
) -> Reference:
    """Straight to the goal (m) within the horizon of so many steps, at a cruising speed."""
    share = torch.linspace(0, 1, steps + 1, dtype=goal.dtype, device=goal.device)[:, None]
    now = motion.position.unsqueeze(-2)
    path = now + share * (goal.unsqueeze(-2) - now)
    return Reference(path, torch.full_like(goal[..., 0], speed_mps))


def predicted_reference(
    motion: Motion, path: Float[Tensor, "*b T 2"], goal: Float[Tensor, "*b 2"], dt_s: float
) -> Reference:
    """Along a predicted path (m) to the goal, at the mean speed along it; see `bent_to_goal`."""
    reference = torch.cat([motion.position.unsqueeze(-2), bent_to_goal(path, goal)], -2)
    steps = reference[..., 1:, :] - reference[..., :-1, :]
    speed = steps.square().sum(-1).clamp_min(1e-8).sqrt().mean(-1) / dt_s
    return Reference(reference, speed)


def bent_to_goal(
    path: Float[Tensor, "*b T 2"], goal: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b T 2"]:
    """A path that ends at the goal, in m, instead of where it ends.

        p(s) + ½ (3 s² - s³) (g - p(1)),    s = t / T

    which adds the least squared acceleration that leads to the goal g, free at its end. Bent
    constant velocity is the cubic Hermite spline to the goal.
    """
    share = shares_ahead(path, path.shape[-2]).unsqueeze(-1)
    shape = 0.5 * share.square() * (3 - share)
    return path + shape * (goal - path[..., -1, :]).unsqueeze(-2)


def straightened(
    path: Float[Tensor, "*b T 2"], goal: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b T 2"]:
    """From where a path (m) begins to the goal at a constant velocity: p₀ + s (g - p₀), s = t / T.

    It begins a step before its first position, as far back as that is from the second.
    """
    first, second = path[..., :1, :], path[..., 1:2, :]
    start = 2 * first - second if path.shape[-2] > 1 else first
    share = shares_ahead(path, path.shape[-2]).unsqueeze(-1)
    return torch.lerp(start, goal.unsqueeze(-2), share)
