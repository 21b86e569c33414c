"""Makes the quadratic model convex where it is not."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.riccati import LinearQuadratic, Policy, box_policy


def project(lq: LinearQuadratic) -> LinearQuadratic:
    """Replace each Hessian over (x_t, u_t) by the nearest positive semidefinite one: negative eigenvalues become zero."""
    n = lq.final_x.shape[0]
    upper = torch.cat([lq.xx, lq.ux.transpose(1, 2)], 2)
    H = torch.cat([upper, torch.cat([lq.ux, lq.uu], 2)], 1)
    stage, final = (_nearest(block) for block in (H.movedim(-1, 1), lq.final_xx.movedim(-1, 0)))
    stage = stage.movedim(1, -1)
    return lq._replace(
        xx=stage[:, :n, :n], ux=stage[:, n:, :n], uu=stage[:, n:, n:], final_xx=final.movedim(0, -1)
    )


def _nearest(H: Float[Tensor, "*b k k"]) -> Float[Tensor, "*b k k"]:
    values, vectors = torch.linalg.eigh(H.nan_to_num())
    return (vectors * values.clamp_min(0).unsqueeze(-2)) @ vectors.mT


def definite_policy(
    lq: LinearQuadratic,
    u: Float[Tensor, "T m N"],
    box: Float[Tensor, "2 m"],
    damping: Float[Tensor, " N"],
) -> Policy:
    """Policy of the exact model where it is convex along the recursion, else of its convex projection.

    Exact means the Hessian of the Lagrangian: Newton's method with its quadratic convergence. A problem in which any
    Q_uu is indefinite is solved a second time with every stage projected.
    """
    lower, upper = box[0].unsqueeze(-1) - u, box[1].unsqueeze(-1) - u
    policy = box_policy(lq, lower, upper, damping)
    index = policy.shifted.nonzero().squeeze(-1)
    if len(index) == 0:
        return policy
    part = LinearQuadratic(*(block[..., index] for block in lq))
    convex = box_policy(project(part), lower[..., index], upper[..., index], damping[index])
    return Policy(
        *(whole.index_copy(-1, index, fixed) for whole, fixed in zip(policy, convex, strict=True))
    )
