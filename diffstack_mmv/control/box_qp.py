"""Small convex quadratic programs in a box, one per problem, solved exactly; the batch is the last dimension."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.batch_last import apply

NEWTON_STEPS = 12
HALVINGS = 8


def solve_box_qp(
    H: Float[Tensor, "m m N"],
    g: Float[Tensor, "m N"],
    lower: Float[Tensor, "m N"],
    upper: Float[Tensor, "m N"],
) -> tuple[Float[Tensor, "m N"], Bool[Tensor, "m N"]]:
    """Minimise ½ k'Hk + g'k in lower ≤ k ≤ upper, for positive definite H.

    One and two variables: the minimum over all active sets in closed form. More: projected Newton [TASSA], which ends
    after finitely many steps for a quadratic; twelve are enough at the sizes of a control vector.

    Returns:
        The minimiser, and which of its entries are free (strictly inside of their interval).
    """
    m = g.shape[0]
    if m == 1:
        k = torch.clamp(-g / H[0], lower, upper)
    elif m == 2:
        k = _minimum_of_active_sets(H, g, lower, upper)
    else:
        k = _projected_newton(H, g, lower, upper)
    return k, (k > lower) & (k < upper)


def _value(H: Tensor, g: Tensor, k: Tensor) -> Tensor:
    return ((0.5 * apply(H, k) + g) * k).sum(0)


def _minimum_of_active_sets(H: Tensor, g: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """The unconstrained minimiser if it lies inside, else the best of the four edges."""
    a, b, c = H[0, 0], H[0, 1], H[1, 1]
    inside = torch.stack([b * g[1] - c * g[0], b * g[0] - a * g[1]]) / (a * c - b * b)
    feasible = ((inside >= lower) & (inside <= upper)).all(0)
    best = best_value = None
    for bound in (lower, upper):
        on_first = torch.stack(
            [bound[0], torch.clamp(-(g[1] + b * bound[0]) / c, lower[1], upper[1])]
        )
        on_second = torch.stack(
            [torch.clamp(-(g[0] + b * bound[1]) / a, lower[0], upper[0]), bound[1]]
        )
        for edge in (on_first, on_second):
            value = _value(H, g, edge)
            if best is None or best_value is None:
                best, best_value = edge, value
            better = value < best_value
            best, best_value = (
                torch.where(better, edge, best),
                torch.where(better, value, best_value),
            )
    return torch.where(feasible, inside, best if best is not None else inside)


def free_inverse(H: Float[Tensor, "m m N"], free: Bool[Tensor, "m N"]) -> Float[Tensor, "m m N"]:
    """Inverse of the free rows and columns of H, zero elsewhere; H is symmetric, not necessarily definite."""
    m = H.shape[0]
    eye = torch.eye(m, dtype=torch.bool, device=H.device).unsqueeze(-1)
    mask = free.unsqueeze(0) & free.unsqueeze(1)
    block = torch.where(mask, H, eye.to(H.dtype))
    if m == 1:
        inverse = 1 / block
    elif m == 2:
        a, b, c = block[0, 0], block[0, 1], block[1, 1]
        inverse = torch.stack([torch.stack([c, -b]), torch.stack([-b, a])]) / (a * c - b * b)
    else:
        inverse = torch.linalg.inv_ex(block.movedim(-1, 0))[0].movedim(0, -1)
    return torch.where(mask, inverse, torch.zeros_like(inverse))


def positive_lift(Q: Float[Tensor, "m m N"], definite: float) -> Float[Tensor, "m N"]:
    """What to add to the diagonal of a symmetric Q to make it positive definite; zero where it is.

    One and two variables: the modified Cholesky factorisation with pivoting, which leaves the larger
    diagonal entry alone if it can, so that a curvature in one direction does not spoil the other.
    More: the same lift for all. The smallest pivot is `definite` times the largest entry.
    """
    scale = Q.abs().amax((0, 1))
    floor = definite * scale + torch.finfo(Q.dtype).tiny
    m = Q.shape[0]
    if m == 1:
        return (floor - Q[0]).clamp_min(0)
    if m > 2:
        smallest = torch.linalg.eigvalsh(Q.movedim(-1, 0))[..., 0]
        return (floor - smallest).clamp_min(0).expand(m, -1)
    pivot, other = torch.maximum(Q[0, 0], Q[1, 1]), torch.minimum(Q[0, 0], Q[1, 1])
    square = Q[0, 1].square()
    raised = torch.maximum(pivot, torch.maximum(floor, square / (scale + torch.finfo(Q.dtype).tiny)))
    lifts = raised - pivot, (floor + square / raised - other).clamp_min(0)
    is_first = Q[0, 0] >= Q[1, 1]
    return torch.stack([torch.where(is_first, *lifts), torch.where(is_first, lifts[1], lifts[0])])


def _projected_newton(H: Tensor, g: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    k = torch.clamp(torch.zeros_like(g), lower, upper)
    for _ in range(NEWTON_STEPS):
        slope = apply(H, k) + g
        clamped = ((k <= lower) & (slope > 0)) | ((k >= upper) & (slope < 0))
        step = -apply(free_inverse(H, ~clamped), slope)
        best, best_value = k, _value(H, g, k)
        for halving in range(HALVINGS):
            trial = torch.clamp(k + 0.5**halving * step, lower, upper)
            value = _value(H, g, trial)
            better = value < best_value
            best, best_value = (
                torch.where(better, trial, best),
                torch.where(better, value, best_value),
            )
        k = best
    return k
