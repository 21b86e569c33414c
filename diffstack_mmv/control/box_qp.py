"""Small convex quadratic programs in a box, solved exactly; the batch is the last dimension."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.batch_last import apply
from diffstack_mmv.types import on_host

MOST_EXCHANGES = 200  # far more than any problem of a few variables was seen to need
EXCHANGES_PER_VARIABLE = 4
"""Where a loop cannot ask for its end; enough for all but one in ten thousand problems."""


def solve_box_qp(
    H: Float[Tensor, "m m N"],
    g: Float[Tensor, "m N"],
    lower: Float[Tensor, "m N"],
    upper: Float[Tensor, "m N"],
) -> tuple[Float[Tensor, "m N"], Bool[Tensor, "m N"]]:
    """Minimise ½ k'Hk + g'k in lower ≤ k ≤ upper, for H positive definite where there is a choice.

    One and two variables: the minimum over all active sets in closed form. More: block principal
    pivoting, which ends at the exact active set after a few linear systems.

    Args:
        H: Matrices, positive definite in the variables whose bounds differ.
        g: Linear terms.
        lower: Lower bounds, -∞ where there is none.
        upper: Upper bounds, not below the lower ones.

    Returns:
        The minimiser, and which of its entries are free (strictly inside of their interval).

    Source:
        Júdice and Pires, A block principal pivoting algorithm for large-scale strictly monotone
        linear complementarity problems, Computers & Operations Research 21, 1994.
    """
    m = g.shape[0]
    if m == 1:
        k = torch.clamp(-g / H[0], lower, upper)
    elif m == 2:
        k = _minimum_of_active_sets(H, g, lower, upper)
    else:
        k = _principal_pivoting(H, g, lower, upper)
    return k, (k > lower) & (k < upper)


def _minimum_of_active_sets(H: Tensor, g: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """The unconstrained minimiser if it lies inside, else the best of the four edges.

    Written on components: reductions over two entries would cost a compiled loop its vectors.
    """
    a, b, c = H[0, 0], H[0, 1], H[1, 1]
    g0, g1 = g[0], g[1]
    low0, low1, high0, high1 = lower[0], lower[1], upper[0], upper[1]
    determinant = a * c - b * b
    k0, k1 = (b * g1 - c * g0) / determinant, (b * g0 - a * g1) / determinant
    feasible = (k0 >= low0) & (k0 <= high0) & (k1 >= low1) & (k1 <= high1)

    def along_second(k0: Tensor) -> tuple[Tensor, Tensor]:
        return k0, torch.minimum(torch.maximum(-(g1 + b * k0) / c, low1), high1)

    def along_first(k1: Tensor) -> tuple[Tensor, Tensor]:
        return torch.minimum(torch.maximum(-(g0 + b * k1) / a, low0), high0), k1

    def value(k0: Tensor, k1: Tensor) -> Tensor:
        return k0 * (0.5 * a * k0 + b * k1 + g0) + k1 * (0.5 * c * k1 + g1)

    best = along_second(low0)
    best_value = value(*best)
    for edge in (along_second(high0), along_first(low1), along_first(high1)):
        edge_value = value(*edge)
        better = edge_value < best_value
        best_value = torch.where(better, edge_value, best_value)
        best = torch.where(better, edge[0], best[0]), torch.where(better, edge[1], best[1])
    return torch.stack([torch.where(feasible, k0, best[0]), torch.where(feasible, k1, best[1])])


def free_inverse(H: Float[Tensor, "m m N"], free: Bool[Tensor, "m N"]) -> Float[Tensor, "m m N"]:
    """Inverse of the free rows and columns of a symmetric H, definite or not; zero elsewhere."""
    m = H.shape[0]
    if m == 2:
        return _free_inverse_of_pair(H, free)
    eye = torch.eye(m, dtype=torch.bool, device=H.device).unsqueeze(-1)
    mask = free.unsqueeze(0) & free.unsqueeze(1)
    block = torch.where(mask, H, eye.to(H.dtype))
    inverse = 1 / block if m == 1 else torch.linalg.inv_ex(block.movedim(-1, 0))[0].movedim(0, -1)
    return torch.where(mask, inverse, torch.zeros_like(inverse))


def _free_inverse_of_pair(H: Tensor, free: Tensor) -> Tensor:
    a, b, c = H[0, 0], H[0, 1], H[1, 1]
    both, zero = free[0] & free[1], torch.zeros_like(a)
    determinant = a * c - b * b
    first = torch.where(both, c / determinant, torch.where(free[0], 1 / a, zero))
    second = torch.where(both, a / determinant, torch.where(free[1], 1 / c, zero))
    cross = torch.where(both, -b / determinant, zero)
    return torch.stack([torch.stack([first, cross]), torch.stack([cross, second])])


def regular_inverse(
    H: Float[Tensor, "m m N"], free: Bool[Tensor, "m N"], noise: Float[Tensor, "m N"]
) -> Float[Tensor, "m m N"]:
    """Inverse of as many free rows and columns of a symmetric H as have one; zero elsewhere.

    Swept from the largest pivot in units of its noise on. What is left of a row that does not stand
    out of its noise is zero: that variable does not matter, and stays where it is.

    Args:
        H: Symmetric matrices, definite or not.
        free: Rows and columns that may be inverted.
        noise: What rounding may have left of each diagonal entry, positive.

    Source:
        Goodnight, A tutorial on the SWEEP operator, The American Statistician 33, 1979.
    """
    m = H.shape[0]
    order = torch.arange(m, device=H.device).unsqueeze(-1)
    zero, swept = torch.zeros_like(noise), torch.zeros_like(free)
    H = torch.where(free.unsqueeze(0) & free.unsqueeze(1), H, torch.zeros_like(H))
    for _ in range(m):
        size = H.diagonal(dim1=0, dim2=1).movedim(-1, 0).abs() / noise
        size = torch.where(free & ~swept, size, -1.0)
        chosen = (order == size.argmax(0)) & (size > 1)
        column = torch.where(chosen, H, zero).sum(1)
        pivot = torch.where(chosen.any(0), torch.where(chosen, column, zero).sum(0), 1.0)
        scaled = column / pivot
        rest = H - column * scaled.unsqueeze(1)
        corner = torch.where(chosen, -1 / pivot, scaled)
        rest = torch.where(chosen.unsqueeze(0), corner.unsqueeze(1), rest)
        H = torch.where(chosen.unsqueeze(1), corner.unsqueeze(0), rest)
        swept = swept | chosen
    return torch.where(swept.unsqueeze(0) & swept.unsqueeze(1), -H, torch.zeros_like(H))


def largest(Q: Float[Tensor, "m m N"]) -> Float[Tensor, " N"]:
    """Largest entry of a symmetric matrix in absolute value."""
    if Q.shape[0] > 2:
        return Q.abs().amax((0, 1))
    diagonal = torch.maximum(Q[0, 0].abs(), Q[-1, -1].abs())
    return torch.maximum(diagonal, Q[0, -1].abs())


def parted(Q: Float[Tensor, "m m N"], free: Bool[Tensor, "m N"]) -> Float[Tensor, "m m N"]:
    """A symmetric Q in which the rows that are not free have their diagonal alone."""
    eye = torch.eye(len(Q), dtype=torch.bool, device=Q.device).unsqueeze(-1)
    return torch.where(free.unsqueeze(0) & free.unsqueeze(1) | eye, Q, torch.zeros_like(Q))


def positive_lift(Q: Float[Tensor, "m m N"], definite: float) -> Float[Tensor, "m N"]:
    """What to add to the diagonal of a symmetric Q to make it positive definite; zero where it is.

    The modified Cholesky factorisation with pivoting: the largest diagonal entry of what is left
    comes first, so that a curvature in one direction does not spoil another. A pivot below
    `definite` times its diagonal entry (which counts as no less than `definite` times the largest
    entry, since a control without curvature has no unit) is replaced by its modulus, or by that
    limit: a step along negative curvature is then as long as one along as much positive curvature.
    With the limit alone it would be as long as the box or the line search allows, and hundreds of
    iterations were seen. No pivot is so small that its column, divided by it, outweighs the largest
    entry.

    Source:
        Gill, Murray and Wright, Practical Optimization, 1981, section 4.4.2.2; differs in the
        modulus (as the saddle-free Newton method) and in the pivot by value.
    """
    scale = largest(Q)
    tiny = torch.finfo(Q.dtype).tiny
    m = Q.shape[0]
    own = Q.diagonal(dim1=0, dim2=1).movedim(-1, 0).abs()
    floor = definite * torch.maximum(own, definite * scale) + tiny
    if m == 1:
        return _upright(Q[0], floor) - Q[0]
    if m > 2:
        return _lift_by_factors(Q, floor, scale + tiny)
    is_first, square = Q[0, 0] >= Q[1, 1], Q[0, 1].square()
    pivot, other = torch.maximum(Q[0, 0], Q[1, 1]), torch.minimum(Q[0, 0], Q[1, 1])
    of_pivot, of_other = torch.where(is_first, floor, floor.flip(0))
    raised = torch.maximum(_upright(pivot, of_pivot), square / (scale + tiny))
    rest = other - square / raised
    lifts = raised - pivot, _upright(rest, of_other) - rest
    return torch.stack([torch.where(is_first, *lifts), torch.where(is_first, lifts[1], lifts[0])])


def _upright(pivot: Float[Tensor, "*k N"], floor: Float[Tensor, "*k N"]) -> Float[Tensor, "*k N"]:
    """The pivot if it is at least `floor`, else its modulus, or `floor` where that is larger."""
    return torch.where(pivot < floor, torch.maximum(pivot.abs(), floor), pivot)


def _lift_by_factors(
    Q: Float[Tensor, "m m N"], floor: Float[Tensor, "m N"], scale: Float[Tensor, " N"]
) -> Float[Tensor, "m N"]:
    """The lift for any size, column by column; no device has to wait for it, as for eigenvalues."""
    m = Q.shape[0]
    zero = torch.zeros_like(Q[0])
    order = torch.arange(m, device=Q.device).unsqueeze(-1)
    left, lift = torch.ones_like(zero, dtype=torch.bool), zero
    for _ in range(m):
        diagonal = Q.diagonal(dim1=0, dim2=1).movedim(-1, 0)
        chosen = order == torch.where(left, diagonal, -torch.inf).argmax(0)
        column = torch.where(chosen, Q, zero).sum(1)
        pivot = torch.where(chosen, column, zero).sum(0)
        left = left & ~chosen
        column = torch.where(left, column, zero)
        least = torch.where(chosen, floor, zero).sum(0)
        raised = torch.maximum(_upright(pivot, least), column.square().amax(0) / scale)
        lift = lift + torch.where(chosen, raised - pivot, zero)
        Q = Q - column * column.unsqueeze(1) / raised
    return lift


class _ActiveSet(NamedTuple):
    """A guess of which variables lie on a bound, and how the search for them goes."""

    side: Int[Tensor, "m N"]  # -1 on the lower bound, +1 on the upper one, 0 free
    fewest: Int[Tensor, " N"]  # least number of contradicted entries so far
    patient: Bool[Tensor, " N"]  # whether one exchange of all entries may fail to lower it


def _principal_pivoting(H: Tensor, g: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """Guess the active set, and exchange the entries that the optimality conditions contradict.

    What has no choice is never free: H need not be definite in it, and other guesses would mislead.
    All at once while their number falls, and once more; then the last one only, until it does.
    Exchanging the last one ends after finitely many steps for every positive definite H (Murty's
    rule). Unlike the steps of a projected method, none can be too short to be taken.
    """
    side = -(lower >= upper).to(torch.int8)
    fewest = torch.full_like(side[0], len(g) + 1)
    guess = _ActiveSet(side, fewest, torch.ones_like(fewest, dtype=torch.bool))
    # a loop that asks for its end can be neither compiled nor queued on another device
    can_ask = not torch.compiler.is_compiling() and on_host(g)
    k = g
    for _ in range(MOST_EXCHANGES if can_ask else EXCHANGES_PER_VARIABLE * len(g)):
        k, wanted = _implied(H, g, lower, upper, guess.side)
        wrong = wanted != guess.side
        if can_ask and not wrong.any():
            break
        guess = _exchanged(guess, wrong, wanted)
    return torch.minimum(torch.maximum(k, lower), upper)


def _implied(
    H: Tensor, g: Tensor, lower: Tensor, upper: Tensor, side: Tensor
) -> tuple[Tensor, Tensor]:
    """Stationary point with the active entries on their bounds, and the sides it asks for."""
    free, none = side == 0, torch.zeros_like(side)
    fixed = torch.where(side < 0, lower, torch.where(side > 0, upper, torch.zeros_like(g)))
    inner = -apply(free_inverse(H, free), apply(H, fixed) + g)
    k = torch.where(free, inner, fixed)
    slope = apply(H, k) + g
    outside = torch.where(k < lower, none - 1, torch.where(k > upper, none + 1, none))
    pulled = (side * slope > 0) & (lower < upper)  # off its bound, if there is another place
    return k, torch.where(free, outside, torch.where(pulled, none, side))


def _exchanged(guess: _ActiveSet, wrong: Tensor, wanted: Tensor) -> _ActiveSet:
    order = torch.arange(1, len(wrong) + 1, dtype=torch.int8, device=wrong.device).unsqueeze(-1)
    number = wrong.sum(0, dtype=torch.int8)
    fewer = number < guess.fewest
    last = order == (wrong * order).amax(0)
    chosen = wrong & (fewer | guess.patient | last)
    side = torch.where(chosen, wanted, guess.side)
    return _ActiveSet(side, torch.minimum(guess.fewest, number), fewer)
