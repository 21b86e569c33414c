"""One iteration of the solver: where each problem stands, and its next step."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.line_search import search
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.riccati import Policy, farthest, is_far
from diffstack_mmv.types import SolverStatus

OPEN = -1  # status of a problem that is still being solved
NEAR = 0.3  # predicted decrease relative to the cost below which a problem is near its solution
NOISE = 8.0  # multiple of the rounding noise of the cost that counts as no decrease
DAMPING_MAX = 1e8
DAMPING_GROWTH, DAMPING_DECAY = 8.0, 0.2
LONG = 0.5  # step size from which on a step is long
LARGE = 6  # state columns from which on the lift of a convex model may come down
SHARE_MIN = 1e-4  # least share of it
SHARE_GROWTH, SHARE_DECAY = 4.0, 0.1


class Iterate(NamedTuple):
    """Where each problem stands."""

    x: Float[Tensor, "T1 n N"]
    u: Float[Tensor, "T m N"]
    cost: Float[Tensor, " N"]
    damping: Float[Tensor, " N"]
    share: Float[Tensor, " N"]  # of the lift of the convex model, see `definite_policies`
    status: Int[Tensor, " N"]
    iterations: Int[Tensor, " N"]
    near: Bool[Tensor, " N"]  # whether the last model promised a small decrease only


class Settings(NamedTuple):
    """The numbers of a solver, as tensors: a change of value compiles nothing anew."""

    box: Float[Tensor, "2 m"]
    sizes: Float[Tensor, " S"]  # step sizes, falling from 1
    tolerance: Float[Tensor, ""]
    regularisation: Float[Tensor, ""]


def attempt(
    dynamics: Dynamics,
    cost: Cost,
    like: Float[Tensor, "*b"],
    iterate: Iterate,
    magnitude: Float[Tensor, " N"],
    noise: Float[Tensor, " N"],
    policy: Policy,
    settings: Settings,
) -> Iterate:
    """Roll the policy out, accept or refuse it problem by problem, and judge which are finished.

    Finished is a problem whose model promises a decrease of the cost below the tolerance times
    Σ|c_t|, or below the noise; the promise of a strongly damped model counts for nothing. If no
    step size lowers the cost, a promise of a few times the noise is enough. The projected gradient
    has to agree, see `ILQR`: it is a coarser measure, but one that no step of the model enters.
    """
    noise = NOISE * noise
    trial = search(
        dynamics,
        cost,
        like,
        iterate.x,
        iterate.u,
        policy.gains,
        settings.box,
        settings.sizes,
        noise,
    )
    is_open = iterate.status == OPEN
    enough = torch.maximum(settings.tolerance * magnitude, noise)
    lower = trial.cost < iterate.cost
    flat = (policy.decrease <= enough) & (iterate.damping < 1)
    flat = flat | (~lower & (policy.decrease <= NOISE * noise))
    settled = flat & (policy.slope <= enough.sqrt() * magnitude.sqrt())
    # the cost is flat at its minimum: a last Newton step is good to more digits than it shows
    accepted = is_open & (lower | (flat & (trial.cost <= iterate.cost + noise)))
    damping = next_damping(iterate.damping, accepted, trial.size, settings.regularisation)
    share = next_share(iterate.share, accepted, trial.size, len(iterate.x[0]))
    status = torch.where(damping > DAMPING_MAX, SolverStatus.STALLED, iterate.status)
    status = torch.where(settled, SolverStatus.CONVERGED, status)
    status = torch.where(policy.decrease.isfinite(), status, SolverStatus.NOT_FINITE)
    return Iterate(
        torch.where(accepted, trial.x, iterate.x),
        torch.where(accepted, trial.u, iterate.u),
        torch.where(accepted, trial.cost, iterate.cost),
        torch.where(is_open, damping, iterate.damping),
        torch.where(is_open, share, iterate.share),
        torch.where(is_open, status, iterate.status),
        iterate.iterations + is_open.to(iterate.iterations.dtype),
        policy.decrease <= NEAR * magnitude,
    )


def cheaper(
    before: Iterate, first: Iterate, second: Iterate, either: Bool[Tensor, " N"]
) -> Iterate:
    """The second attempt where `either` holds and it alone lowers the cost most, else the first."""
    other = either & (second.cost < torch.minimum(first.cost, before.cost))
    return Iterate(*(torch.where(other, b, a) for a, b in zip(first, second, strict=True)))


def start(
    attempt: Callable[..., Iterate],
    dynamics: Dynamics,
    cost: Cost,
    like: Float[Tensor, "*b"],
    state: Float[Tensor, "n N"],
    controls: Float[Tensor, "T m N"],
    settings: Settings,
) -> Iterate:
    """Roll out the guess, clipped to the box.

    This is an attempt from an infinite cost with a policy that changes nothing, so that it needs no
    kernel of its own.
    """
    T, m, N = controls.shape
    n = state.shape[0]
    zero, none = torch.zeros_like(state[0]), torch.zeros_like(state[0], dtype=torch.bool)
    status = torch.full_like(zero, OPEN, dtype=torch.long)
    x = state.expand(T + 1, n, N).contiguous()
    count = torch.zeros_like(status)
    nowhere = Iterate(x, controls, zero + torch.inf, zero, zero + 1, status, count, none)
    idle = Policy(controls.new_zeros(T, m + m * n, N), zero + 1, zero.clone(), none, none)
    guess = attempt(dynamics, cost, like, nowhere, zero.clone(), zero.clone(), idle, settings)
    finite = guess.cost.isfinite() & guess.x.isfinite().all(0).all(0)
    status = torch.where(finite, status, SolverStatus.NOT_FINITE)
    lower, upper = settings.box
    in_order = (lower <= upper).all()  # known before on a CPU; another device is not waited for
    status = torch.where(in_order, status, SolverStatus.INFEASIBLE)
    return guess._replace(damping=zero, share=zero + 1, status=status, iterations=count)


def concluded(iterate: Iterate) -> Int[Tensor, " N"]:
    """Status at the end; a limit of the iterations is what leaves a problem open.

    A control without bound goes no farther than `farthest`. A problem that ends there, or at a cost
    that has gone down to its square, has no minimum. It is judged at the end only, so that one
    which passes by is not disturbed.
    """
    status = torch.where(iterate.status == OPEN, SolverStatus.ITERATION_LIMIT, iterate.status)
    ran_off = is_far(iterate.u).any(0).any(0) | (iterate.cost <= -(farthest(iterate.u.dtype) ** 2))
    return torch.where((iterate.iterations > 0) & ran_off, SolverStatus.UNBOUNDED, status)


def next_damping(
    damping: Float[Tensor, " N"],
    accepted: Bool[Tensor, " N"],
    size: Float[Tensor, " N"],
    regularisation: Float[Tensor, ""],
) -> Float[Tensor, " N"]:
    """Less after a long step, none once it is small, more after a refused one."""
    less = torch.where(size >= LONG, damping * DAMPING_DECAY, damping)
    less = torch.where(less < 0.1 * regularisation, torch.zeros_like(less), less)
    more = torch.maximum(damping * DAMPING_GROWTH, regularisation)
    return torch.where(accepted, less, more)


def next_share(
    share: Float[Tensor, " N"],
    accepted: Bool[Tensor, " N"],
    size: Float[Tensor, " N"],
    columns: int,
) -> Float[Tensor, " N"]:
    """Less of the lift after a long step, more after a short or a refused one.

    The bound that it follows is the looser the more columns the state has. Small models keep all of
    it: their steps are long enough, and longer ones would rather end in another minimum.
    """
    if columns < LARGE:
        return share
    less = (share * SHARE_DECAY).clamp_min(SHARE_MIN)
    more = (share * SHARE_GROWTH).clamp_max(1)
    return torch.where(accepted & (size >= LONG), less, more)
