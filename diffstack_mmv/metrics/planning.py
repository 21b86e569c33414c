"""Scores of plans, one number per sample."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.metrics.means import where_known
from diffstack_mmv.types import Obstacles, Plan


def collided(
    position: Float[Tensor, "*b T1 2"], radius: Float[Tensor, "*b"], obstacles: Obstacles
) -> Float[Tensor, "*b"]:
    """1 where the disc of the plan overlaps the disc of any agent at any time after now, else 0.

    Args:
        position: Planned positions in m, row 0 is now.
        radius: Radius of the ego in m.
        obstacles: Agents whose one component is their true future.

    Returns:
        Dimensionless; NaN for a plan that is not finite.
    """
    offset = position[..., None, None, :, :] - obstacles.position
    reach = (radius.unsqueeze(-1) + obstacles.radius)[..., None, None]
    overlap = (offset.square().sum(-1) < reach.square()) & obstacles.valid[..., None, None]
    hit = overlap[..., 1:].flatten(-3).any(-1)
    return where_known(hit.to(position), position.isfinite().flatten(-2).all(-1))


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
