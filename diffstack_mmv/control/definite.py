"""Makes the quadratic model convex where it is not."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.batch_last import unpack
from diffstack_mmv.control.riccati import LinearQuadratic, Policy, final_shapes, stage_shapes


def project(lq: LinearQuadratic, n: int, m: int) -> LinearQuadratic:
    """Replace each Hessian over (x_t, u_t) by the nearest positive semidefinite one.

    Nearest in the Frobenius norm: negative eigenvalues become zero.
    """
    *first, xx, ux, uu = unpack(lq.stages, *stage_shapes(n, m))
    H = torch.cat([torch.cat([xx, ux.transpose(1, 2)], 2), torch.cat([ux, uu], 2)], 1)
    H = _nearest(H.movedim(-1, 1)).movedim(1, -1)
    parts = (*first, H[:, :n, :n], H[:, n:, :n], H[:, n:, n:])
    x, final_xx = unpack(lq.final, *final_shapes(n))
    final = _nearest(final_xx.movedim(-1, 0)).movedim(0, -1)
    return LinearQuadratic(
        torch.cat([part.flatten(1, -2) for part in parts], 1), torch.cat([x, final.flatten(0, 1)])
    )


def definite_policy(
    solve: Callable[..., Policy],
    lq: LinearQuadratic,
    room: tuple[Float[Tensor, "T m N"], Float[Tensor, "T m N"]],
    damping: Float[Tensor, " N"],
    n: int,
) -> Policy:
    """Policy of the exact model where it is convex along the recursion, else of its projection.

    Exact means the Hessian of the Lagrangian: Newton's method with its quadratic convergence. A
    problem in which any Q_uu is indefinite is solved a second time with every stage projected.

    Args:
        solve: `box_policy`, or a compiled form of it.
        lq: The exact model.
        room: Lower and upper bound minus present control.
        damping: μ of each problem, dimensionless.
        n: Number of state columns.
    """
    lower, upper = room
    policy = solve(lq, lower, upper, damping, n)
    index = policy.shifted.nonzero().squeeze(-1)
    if len(index) == 0:
        return policy
    if len(index) == 1 < len(damping):
        index = index.repeat(2)  # a batch of one would be compiled separately
    part = project(LinearQuadratic(*(rows[..., index] for rows in lq)), n, lower.shape[1])
    convex = solve(part, lower[..., index], upper[..., index], damping[index], n)
    return Policy(
        *(whole.index_copy(-1, index, fixed) for whole, fixed in zip(policy, convex, strict=True))
    )


def _nearest(H: Float[Tensor, "... k k"]) -> Float[Tensor, "... k k"]:
    values, vectors = torch.linalg.eigh(H.nan_to_num())
    return (vectors * values.clamp_min(0).unsqueeze(-2)) @ vectors.mT
