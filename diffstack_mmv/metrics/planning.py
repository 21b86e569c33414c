"""Scores of plans, one number per sample."""

from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.types import Obstacles


def collides(
    position: Float[Tensor, "*b T1 2"], radius: Float[Tensor, "*b"], obstacles: Obstacles
) -> Bool[Tensor, "*b"]:
    """Whether the disc of the plan overlaps the disc of any agent at any time after now.

    Args:
        position: Planned positions in m, row 0 is now.
        radius: Radius of the ego in m.
        obstacles: Agents whose one component is their true future.
    """
    offset = position[..., None, None, :, :] - obstacles.position
    reach = (radius.unsqueeze(-1) + obstacles.radius)[..., None, None]
    overlap = (offset.square().sum(-1) < reach.square()) & obstacles.valid[..., None, None]
    return overlap[..., 1:].flatten(-3).any(-1)


def overlap_now(
    position: Float[Tensor, "*b 2"], radius: Float[Tensor, "*b"], obstacles: Obstacles
) -> Bool[Tensor, "*b"]:
    """Whether the discs (m) overlap already at the start, where no plan can be blamed."""
    offset = position[..., None, :] - obstacles.position[..., 0, 0, :]
    reach = radius.unsqueeze(-1) + obstacles.radius
    return ((offset.square().sum(-1) < reach.square()) & obstacles.valid).any(-1)
