"""Scores of plans, one number per sample."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import distance_to_outline
from diffstack_mmv.metrics.means import where_known
from diffstack_mmv.types import Discs, Obstacles, Plan, Tracks

FAR_M = 1e6
"""A place where nobody is."""


def collided(
    position: Float[Tensor, "*b T1 2"],
    heading: Float[Tensor, "*b T1"],
    discs: Discs,
    obstacles: Obstacles,
) -> Float[Tensor, "*b"]:
    """1 where the vehicle overlaps the disc of any agent at any time after now, else 0.

    Args:
        position: Planned positions in m, row 0 is now.
        heading: Of the vehicle's body at these times, in rad.
        discs: Around the vehicle, `*b D`; its outline is their hull.
        obstacles: Agents whose one component is their true future.

    Returns:
        Dimensionless; NaN for a plan that is not finite.
    """
    distance = distance_to_outline(obstacles.position, position, heading, discs)
    reach = (discs.radius.amax(-1, keepdim=True) + obstacles.radius)[..., None, None]
    overlap = (distance < reach) & obstacles.valid[..., None, None]
    hit = overlap[..., 1:].flatten(-3).any(-1)
    finite = position.isfinite().flatten(-2).all(-1) & heading.isfinite().all(-1)
    return where_known(hit.to(position), finite)


def human_collided(
    past: Tracks, future: Tracks, discs: Discs, obstacles: Obstacles
) -> Float[Tensor, " B"]:
    """What `collided` says of the recorded ego: what the annotation alone makes of riding by.

    A time that was not recorded counts as free.

    Returns:
        Dimensionless; NaN without any recorded future.
    """
    valid = future.valid.unsqueeze(-1)
    far = torch.where(valid, future.motion.position, torch.full_like(future.motion.position, FAR_M))
    position = torch.cat([past.motion.position[..., -1:, :], far], -2)
    ahead = future.motion.heading.nan_to_num()
    heading = torch.cat([torch.zeros_like(ahead[..., :1]), ahead], -1)
    hit = collided(position, heading, discs, obstacles)
    return where_known(hit, future.valid.any(-1))


def total_cost(parts: Mapping[str, Float[Tensor, "*b"]]) -> Float[Tensor, "*b"]:
    """Cost of a plan from the costs of its terms, dimensionless."""
    return torch.stack(list(parts.values())).sum(0)


def planning_loss(
    cross_entropy: Float[Tensor, "*b"], cost: Float[Tensor, "*b"], hindsight: float
) -> Float[Tensor, "*b"]:
    """CE + hindsight · cost, the loss of DiffStack's planner; NaN where a part is."""
    return cross_entropy + hindsight * cost


def solved(plan: Plan) -> Float[Tensor, "*b"]:
    """1 where every start of the solver converged, else 0."""
    return plan.converged.to(plan.motion.position)
