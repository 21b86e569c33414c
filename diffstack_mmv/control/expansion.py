"""Local models around trajectories: linear dynamics, quadratic cost, curvature of the dynamics.

All B·T pairs go through one call. The callables always see the leading dimensions `*b` of the
problem, whatever the solver adds around them (times, step sizes, tangents), because the additions
are `vmap` dimensions: closures over tensors of shape `*b ...` broadcast as their author meant.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.batch_last import from_batch_last, pack, to_batch_last
from diffstack_mmv.control.optimizer import Cost, Dynamics, LinearisedDynamics
from diffstack_mmv.control.riccati import LinearQuadratic, costates


class HessianBlocks(NamedTuple):
    """Hessian of a sum over times whose entry t sees x_t and u_t only."""

    xx: Float[Tensor, "*b T1 n n"]
    ux: Float[Tensor, "*b T1 m n"]
    uu: Float[Tensor, "*b T1 m m"]


def pad_controls(controls: Float[Tensor, "*b T m"]) -> Float[Tensor, "*b T1 m"]:
    """Append the zero row that the cost sees at the final state."""
    return torch.nn.functional.pad(controls, (0, 0, 0, 1))


def step_all(
    dynamics: Dynamics, states: Float[Tensor, "*b T n"], controls: Float[Tensor, "*b T m"]
) -> Float[Tensor, "*b T n"]:
    """One step from each of the T states; `dynamics` sees `*b n`, without the times."""

    # a bare module would be printed by vmap, which no compiler likes
    def one_time(state: Tensor, control: Tensor) -> Tensor:
        return dynamics(state, control)

    return torch.vmap(one_time, (-2, -2))(states, controls).movedim(0, -2)


def _spread(seed: Float[Tensor, " k"], like: Float[Tensor, "*b k"]) -> Float[Tensor, "*b k"]:
    """The seed at every entry, laid out in full: strides of zero would tie a graph to one batch."""
    return seed + torch.zeros(like.shape, dtype=like.dtype, device=like.device)


def linearise_dynamics(
    dynamics: Dynamics, states: Float[Tensor, "*b T n"], controls: Float[Tensor, "*b T m"]
) -> tuple[Float[Tensor, "*b T n n"], Float[Tensor, "*b T n m"]]:
    """Jacobians A, B at every pair: the model's own, or n cotangents pulled back in one call."""
    if isinstance(dynamics, LinearisedDynamics):
        A, B = torch.vmap(dynamics.jacobian, (-2, -2))(states, controls)
        return A.movedim(0, -3), B.movedim(0, -3)
    n = states.shape[-1]
    pull = torch.func.vjp(lambda x, u: step_all(dynamics, x, u), states, controls)[1]
    seeds = torch.eye(n, dtype=states.dtype, device=states.device)
    rows = torch.vmap(lambda seed: pull(_spread(seed, states)))(seeds)
    A, B = (row.movedim(0, -2) for row in rows)
    return A, B


def _curvature(
    gradient: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]],
    states: Float[Tensor, "*b T n"],
    controls: Float[Tensor, "*b T m"],
) -> HessianBlocks:
    """Hessian blocks from the gradient of a sum that is separable over times."""
    n, m = states.shape[-1], controls.shape[-1]
    pull = torch.func.vjp(gradient, states, controls)[1]

    def row(seed_x: Tensor, seed_u: Tensor) -> tuple[Tensor, Tensor]:
        return pull((_spread(seed_x, states), _spread(seed_u, controls)))

    seeds = torch.eye(n + m, dtype=states.dtype, device=states.device)
    of_x, of_u = (part.movedim(0, -2) for part in torch.vmap(row)(seeds[:, :n], seeds[:, n:]))
    return HessianBlocks(of_x[..., :n, :], of_x[..., n:, :], of_u[..., n:, :])


def expand_cost(
    cost: Cost, states: Float[Tensor, "*b T1 n"], controls: Float[Tensor, "*b T1 m"]
) -> tuple[Tensor, Tensor, HessianBlocks]:
    """Gradient in x, gradient in u and Hessian of the cost at every time; controls are padded."""
    gradient = torch.func.grad(lambda x, u: cost(x, u).sum(), (0, 1))
    of_x, of_u = gradient(states, controls)
    return of_x, of_u, _curvature(gradient, states, controls)


def dynamics_curvature(
    dynamics: Dynamics,
    states: Float[Tensor, "*b T n"],
    controls: Float[Tensor, "*b T m"],
    costates: Float[Tensor, "*b T n"],
) -> HessianBlocks:
    """Hessian of λ_{t+1} · f(x_t, u_t) at every pair."""
    return _curvature(_pull_back(dynamics, costates), states, controls)


def _pull_back(
    dynamics: Dynamics, costates: Float[Tensor, "*b T n"]
) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Gradient of Σ λ_{t+1} · f(x_t, u_t) in states and controls."""

    def weighted(x: Tensor, u: Tensor) -> Tensor:
        return (costates * step_all(dynamics, x, u)).sum()

    return torch.func.grad(weighted, (0, 1))


def differenced_curvature(
    dynamics: Dynamics,
    states: Float[Tensor, "*b T n"],
    controls: Float[Tensor, "*b T m"],
    costates: Float[Tensor, "*b T n"],
) -> HessianBlocks:
    """The same by forward differences of the exact gradient, steps √ε in units of the entries.

    Half of the digits, which a step of Newton's method does not miss, and a graph without second
    derivatives: for a large model an eighth of the operations.
    """
    n, m = states.shape[-1], controls.shape[-1]
    step = torch.finfo(states.dtype).eps ** 0.5
    gradient = _pull_back(dynamics, costates)
    # the last row is not shifted: one call, and the same rounding in both parts of a difference
    shifts = step * torch.eye(n + m + 1, n + m, dtype=states.dtype, device=states.device)

    def row(shift_x: Tensor, shift_u: Tensor) -> tuple[Tensor, Tensor]:
        return gradient(states + _spread(shift_x, states), controls + _spread(shift_u, controls))

    of_x, of_u = (
        ((rows[:-1] - rows[-1]) / step).movedim(0, -2)
        for rows in torch.vmap(row)(shifts[:, :n], shifts[:, n:])
    )
    xx, uu = of_x[..., :n, :], of_u[..., n:, :]
    ux = 0.5 * (of_x[..., n:, :] + of_u[..., :n, :].transpose(-2, -1))
    return HessianBlocks(0.5 * (xx + xx.transpose(-2, -1)), ux, 0.5 * (uu + uu.transpose(-2, -1)))


class Model(NamedTuple):
    """Local model of the problem around trajectories, the batch last."""

    quadratic: LinearQuadratic  # with the Hessian of the Lagrangian
    costates: Float[Tensor, "T n N"]  # λ_1 .. λ_T
    gradient: Float[Tensor, "T m N"]  # c_u + B'λ, derivative of the total cost by the controls
    magnitude: Float[Tensor, " N"]  # Σ |c_t|
    noise: Float[Tensor, " N"]  # what rounding each state, control and cost can do to the total


def expand(
    dynamics: Dynamics,
    cost: Cost,
    like: Float[Tensor, "*b"],
    x: Float[Tensor, "T1 n N"],
    u: Float[Tensor, "T m N"],
    near: Bool[Tensor, " N"] | None = None,  # makes no difference here
) -> Model:
    """Linear dynamics, gradient of the cost, and Hessian of the Lagrangian c + λ · f.

    The costates are those of the trajectory, λ_t = c_x,t + A_t' λ_{t+1}. The noise is
    ε (Σ|c| + Σ|x c_x| + Σ|u c_u|) + ½ ε² (Σ|x² c_xx| + Σ|u² c_uu|), ε being the machine precision:
    what a cost in this precision cannot resolve.
    """
    return _expand(dynamics, cost, like, x, u, dynamics_curvature)


def expand_by_differences(
    dynamics: Dynamics,
    cost: Cost,
    like: Float[Tensor, "*b"],
    x: Float[Tensor, "T1 n N"],
    u: Float[Tensor, "T m N"],
    near: Bool[Tensor, " N"],
) -> Model:
    """The same with the curvature of the dynamics by differences, all else exact.

    Problems that are not near their solution go without that curvature: it would not bring them
    there sooner.
    """

    def curvature_of(*arguments: Any) -> HessianBlocks:
        kept = from_batch_last(near, like)[..., None, None, None]
        bend = differenced_curvature(*arguments)
        return HessianBlocks(*(torch.where(kept, bent, torch.zeros_like(bent)) for bent in bend))

    return _expand(dynamics, cost, like, x, u, curvature_of)


def _expand(
    dynamics: Dynamics,
    cost: Cost,
    like: Float[Tensor, "*b"],
    x: Float[Tensor, "T1 n N"],
    u: Float[Tensor, "T m N"],
    curvature_of: Callable[..., HessianBlocks],
) -> Model:
    before, acting = from_batch_last(x[:-1], like), from_batch_last(u, like)
    jacobians = linearise_dynamics(dynamics, before, acting)
    A, B = (to_batch_last(jacobian, like) for jacobian in jacobians)
    value = value_along(cost, like, x, u, A)
    bend = curvature_of(dynamics, before, acting, from_batch_last(value.costates, like))
    return assemble(x, u, A, B, value, HessianBlocks(*(to_batch_last(bent, like) for bent in bend)))


class Value(NamedTuple):
    """Cost along trajectories to second order, and the costates, the batch last."""

    x: Float[Tensor, "T1 n N"]
    u: Float[Tensor, "T m N"]
    hessian: HessianBlocks  # blocks (T1, rows, columns, N)
    costates: Float[Tensor, "T n N"]
    magnitude: Float[Tensor, " N"]


def value_along(
    cost: Cost,
    like: Float[Tensor, "*b"],
    x: Float[Tensor, "T1 n N"],
    u: Float[Tensor, "T m N"],
    A: Float[Tensor, "T n n N"],
) -> Value:
    """Gradient and Hessian of the cost, and λ_t = c_x,t + A_t' λ_{t+1}."""
    states, controls = from_batch_last(x, like), pad_controls(from_batch_last(u, like))
    of_x, of_u, curvature = expand_cost(cost, states, controls)
    c_x, c_u = to_batch_last(of_x, like), to_batch_last(of_u, like)[:-1]
    hessian = HessianBlocks(*(to_batch_last(block, like) for block in curvature))
    magnitude = to_batch_last(cost(states, controls), like).abs().sum(0)
    return Value(c_x, c_u, hessian, costates(A, c_x[:-1], c_x[-1]), magnitude)


def assemble(
    x: Float[Tensor, "T1 n N"],
    u: Float[Tensor, "T m N"],
    A: Float[Tensor, "T n n N"],
    B: Float[Tensor, "T n m N"],
    value: Value,
    bend: HessianBlocks,
) -> Model:
    """One row per time of all that the recursions read; `bend` is the curvature of the dynamics."""
    c_x, c_u, hessian, multipliers, magnitude = value
    blocks = [block[:-1] + bent for block, bent in zip(hessian, bend, strict=True)]
    parts = (A, B, c_x[:-1], c_u, *blocks, u)
    quadratic = LinearQuadratic(
        torch.concatenate([part.flatten(1, -2) for part in parts], 1), pack(c_x[-1], hessian.xx[-1])
    )
    gradient = c_u + (B * multipliers.unsqueeze(2)).sum(1)
    eps = torch.finfo(x.dtype).eps
    rounded = _rounded(x, c_x, hessian.xx, eps) + _rounded(u, c_u, hessian.uu[:-1], eps)
    return Model(quadratic, multipliers, gradient, magnitude, eps * magnitude + rounded)


def _rounded(
    value: Float[Tensor, "t k N"],
    gradient: Float[Tensor, "t k N"],
    hessian: Float[Tensor, "t k k N"],
    eps: float,
) -> Float[Tensor, " N"]:
    """What rounding each entry can do to the cost.

    Where the cost ends at zero, as of a vehicle that has come to rest at its goal, so do the
    gradient and with it all but the term of second order.
    """
    size, curvature = eps * value, hessian.diagonal(dim1=1, dim2=2).movedim(-1, 1)
    return (size * gradient).abs().sum((0, 1)) + 0.5 * (size.square() * curvature.abs()).sum((0, 1))
