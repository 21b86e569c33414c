"""Which policies an iteration tries: of the exact model, of a convex one, or of both."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.riccati import LinearQuadratic, Policy
from diffstack_mmv.types import on_host

FAR = 3e-2  # predicted decrease relative to the cost above which a problem is far from its solution
WHOLE = 256  # problems up to which a pass over all takes no longer than to pick some out


class Policies(NamedTuple):
    """What one iteration tries."""

    first: Policy
    second: Policy | None  # None where `first` is enough for all
    either: Bool[Tensor, " N"]  # problems for which the cheaper of both is taken
    share: Float[Tensor, " N"]  # of the lift of the convex model; one where it is taken alone


def definite_policies(
    solve: Callable[..., Policy],
    lq: LinearQuadratic,
    gradient: Float[Tensor, "T m N"],
    box: Float[Tensor, "2 m"],
    damping: Float[Tensor, " N"],
    magnitude: Float[Tensor, " N"],
    share: Float[Tensor, " N"],
    n: int,
) -> Policies:
    """Policies of the exact model, and of a convex one where that is not convex.

    Exact means the Hessian of the Lagrangian: Newton's method with its quadratic convergence. A
    problem in which any Q_uu is indefinite on free controls (or on any control, far
    from the solution) is solved a second time with the Hessian over (x_t, u_t) of every stage
    lifted until its diagonal dominates. Far from the solution that model is taken: the exact one
    leads to worse minima. Near it both are tried. The convex one lifts far more than it needs to:
    its steps, and what they promise, may be a hundredth of what is left to gain. So it never counts
    for convergence: what the exact model promises does, with Q_uu lifted alone. In large problems
    it is given a share of its lift alone, which falls with every long step (see `next_share`), and
    starts anew from one at every iteration that is far from the solution.

    Args:
        solve: `box_policy`, or a compiled form of it.
        lq: The exact model.
        gradient: Derivative of the total cost by the controls.
        box: Bounds of the controls.
        damping: μ of each problem, dimensionless.
        magnitude: Σ |c_t|.
        share: Share of its lift that the convex model is given, above zero.
        n: Number of state columns.
    """
    exact = solve(lq, gradient, box, damping, torch.zeros_like(damping), n)
    indefinite = exact.lifted_free | (exact.lifted & (exact.decrease > FAR * magnitude))
    # to ask a device for the number would make it wait, and a second pass is cheap there
    index = indefinite.nonzero().squeeze(-1) if on_host(indefinite) else None
    if index is not None and len(index) == 0:
        return Policies(exact, None, indefinite, share)
    lifted = indefinite * share
    convex = _convex_policy(solve, lq, gradient, box, damping, lifted, index, n, exact)
    convex = _sound(convex, indefinite & (share < 1), magnitude)
    # over long horizons the indefinite recursion may overflow: then it promises all there is
    usable = exact.decrease.isfinite() & exact.slope.isfinite()
    far = indefinite & (~usable | (convex.decrease > FAR * magnitude))
    promised = torch.where(usable | ~indefinite, exact.decrease, magnitude)
    promise = {
        "decrease": torch.maximum(promised, convex.decrease),
        "slope": torch.where(usable, torch.maximum(exact.slope, convex.slope), convex.slope),
    }
    either = indefinite & ~far
    share = torch.where(far, torch.ones_like(share), share)
    convex = convex._replace(**promise)
    if index is not None and not bool(either.any()):
        return Policies(convex, None, either, share)
    exact = exact._replace(**promise)
    first = Policy(*(torch.where(far, c, e) for c, e in zip(convex, exact, strict=True)))
    return Policies(first, convex, either, share)


def _convex_policy(
    solve: Callable[..., Policy],
    lq: LinearQuadratic,
    gradient: Tensor,
    box: Tensor,
    damping: Tensor,
    lifted: Tensor,
    index: Tensor | None,
    n: int,
    exact: Policy,
) -> Policy:
    """Policy of the convex model for the problems of `index`, the exact one for the others."""
    if index is None or len(damping) <= WHOLE or 2 * len(index) > len(damping):
        return solve(lq, gradient, box, damping, lifted, n)
    if len(index) == 1 < len(damping):
        index = index.repeat(2)  # a batch of one would be compiled separately
    part = LinearQuadratic(*(part.index_select(-1, index) for part in lq))
    steep, weak = gradient.index_select(-1, index), damping[index]
    convex = solve(part, steep, box, weak, lifted[index], n)
    return Policy(
        *(whole.index_copy(-1, index, fixed) for whole, fixed in zip(exact, convex, strict=True))
    )


def _sound(convex: Policy, relaxed: Bool[Tensor, " N"], magnitude: Float[Tensor, " N"]) -> Policy:
    """A relaxed model that overflows has its step refused, and the next one is lifted by all."""
    lost = relaxed & ~(convex.decrease.isfinite() & convex.slope.isfinite())
    decrease = torch.where(lost, magnitude, convex.decrease)
    slope = torch.where(lost, torch.zeros_like(magnitude), convex.slope)
    return convex._replace(decrease=decrease, slope=slope)
