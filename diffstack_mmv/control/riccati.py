"""Riccati recursions over a batch of linear-quadratic problems, the batch in the last dimension."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.batch_last import (
    apply,
    pack,
    product,
    symmetric,
    transposed_apply,
    transposed_product,
    unpack,
    walk,
)
from diffstack_mmv.control.box_qp import (
    free_inverse,
    largest,
    parted,
    positive_lift,
    regular_inverse,
    solve_box_qp,
)

FLAT = 16.0  # multiple of the rounding of a curvature below which a control is taken to be flat
ARRIVED = 0.99  # share of the farthest control that counts as it
DEFINITE = 1e-6  # smallest pivot of Q_uu relative to its own entry, before it is lifted


class LinearQuadratic(NamedTuple):
    """min Σ ½ z'Hz + h'z over z_t = (δx_t, δu_t), with δx_{t+1} = A δx_t + B δu_t.

    What a step of a recursion reads is one row of one tensor, see `stage_shapes`.
    """

    stages: Float[Tensor, "T R N"]
    final: Float[Tensor, "F N"]  # gradient and Hessian in x_T


class StageShapes(NamedTuple):
    """Shapes of the parts of a stage, in their order."""

    A: tuple[int, int]
    B: tuple[int, int]
    c_x: tuple[int]
    c_u: tuple[int]
    H_xx: tuple[int, int]
    H_ux: tuple[int, int]
    H_uu: tuple[int, int]
    control: tuple[int]


def stage_shapes(n: int, m: int) -> StageShapes:
    """Shapes of a stage with n states and m controls."""
    return StageShapes((n, n), (n, m), (n,), (m,), (n, n), (m, n), (m, m), (m,))


def final_shapes(n: int) -> tuple[tuple[int, ...], ...]:
    """Shapes of the parts of the final row: c_x, H_xx."""
    return (n,), (n, n)


class Policy(NamedTuple):
    """Feedback δu_t = α k_t + K_t δx_t, and what the model promises for it."""

    gains: Float[Tensor, "T m+m*n N"]  # k and K of each time
    decrease: Float[Tensor, " N"]  # predicted decrease of the cost for α = 1
    slope: Float[Tensor, " N"]  # decrease along the projected gradient, to first order
    lifted: Bool[Tensor, " N"]  # whether Q_uu was indefinite anywhere
    lifted_free: Bool[Tensor, " N"]  # whether it was on free controls


class Stationary(NamedTuple):
    """Solution of an equality-constrained linear-quadratic problem."""

    x: Float[Tensor, "T n N"]  # δx_1 .. δx_T
    u: Float[Tensor, "T m N"]
    costate: Float[Tensor, "T n N"]  # of δx_1 .. δx_T


class _Action(NamedTuple):
    """Q function of one time, Q_uu before regularisation."""

    x: Tensor
    u: Tensor
    xx: Tensor
    ux: Tensor
    uu: Tensor


def costates(
    A: Float[Tensor, "T n n N"], x: Float[Tensor, "T n N"], final_x: Float[Tensor, "n N"]
) -> Float[Tensor, "T n N"]:
    """Sensitivities λ_1 .. λ_T of the cost to go: λ_T = c_x,T and λ_t = c_x,t + A_t' λ_{t+1}."""
    n = final_x.shape[0]

    def step(value: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        A_t, x_t = unpack(row, (n, n), (n,))
        return x_t + transposed_apply(A_t, value), value

    return walk(step, final_x, torch.concatenate([A.flatten(1, 2), x], 1), reverse=True)[1]


def _action(value: Tensor, parts: tuple[Tensor, ...]) -> _Action:
    """Q_x = c_x + A'V_x and so on."""
    A, B, x, u, xx, ux, uu = parts
    V_x, V_xx = unpack(value, *final_shapes(len(A)))
    VA, VB = product(V_xx, A), product(V_xx, B)
    return _Action(
        x + transposed_apply(A, V_x),
        u + transposed_apply(B, V_x),
        xx + transposed_product(A, VA),
        ux + transposed_product(B, VA),
        symmetric(uu + transposed_product(B, VB)),
    )


def dominance(H: Float[Tensor, "k k N"], outside: Float[Tensor, "k N"]) -> Float[Tensor, "k N"]:
    """What the diagonal of H lacks to dominate its rows, `outside` being the rest of each row.

    A symmetric matrix whose diagonal dominates is positive semidefinite (Gershgorin).
    """
    diagonal = H.diagonal(dim1=0, dim2=1).movedim(-1, 0)
    return (H.abs().sum(1) - diagonal.abs() + outside - diagonal).clamp_min(0)


def box_policy(
    lq: LinearQuadratic,
    gradient: Float[Tensor, "T m N"],
    box: Float[Tensor, "2 m"],
    damping: Float[Tensor, " N"],
    lifted: Float[Tensor, " N"],
    n: int,
) -> Policy:
    """Backward pass of control-limited DDP.

        Q_x = c_x + A'V_x,          Q_u = c_u + B'V_x
        Q_xx = c_xx + A'V_xx A,     Q_ux = c_ux + B'V_xx A,     Q_uu = c_uu + B'V_xx B
        k = argmin ½ k'Q_uu k + Q_u'k in the box,   K = -Q_uu⁻¹ Q_ux on the free controls, else 0
        V_x = Q_x + K'(Q_uu k + Q_u) + Q_ux'k,   V_xx = Q_xx + K'Q_uu K + K'Q_ux + Q_ux'K

    with Q_uu + μ max|Q_uu| I, its diagonal lifted where it is not positive definite. All this
    counts as a part of the cost of δu, so that the policy minimises one convex model and is a
    direction of descent. A control that its bound holds, by the gradient of the total cost, stays
    there: a stage that released it would count on what other stages cannot do. Nor does its
    curvature lift that of the free ones, which would make Newton's steps on them too short.

    Args:
        lq: The model around the present trajectory.
        gradient: Derivative of the total cost by the controls.
        box: Bounds of the controls.
        damping: μ of each problem, dimensionless.
        lifted: Share of what it lacks to be diagonally dominant by which the Hessian of every stage
            is lifted, 0 for the exact model.
        n: Number of state columns.
    """
    m = box.shape[1]
    eye = torch.eye(n, dtype=box.dtype, device=box.device).unsqueeze(-1)
    eye_u = torch.eye(m, dtype=box.dtype, device=box.device).unsqueeze(-1)

    control = lq.stages[:, -m:]
    infinity = farthest(box.dtype)
    below, above = (side - control for side in box.clamp(-infinity, infinity).unsqueeze(-1))
    holds, zero = is_active(control, gradient, box), torch.zeros_like(control)
    limits = torch.where(holds, zero, below), torch.where(holds, zero, above)

    def step(value: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        *first, xx, ux, uu, _, least, most = unpack(row, *stage_shapes(n, m), (m,), (m,))
        cross = ux.abs()
        xx = xx + eye * lifted * dominance(xx, cross.sum(0))
        uu = uu + eye_u * lifted * dominance(uu, cross.sum(1))
        Q = _action(value, (*first, xx, ux, uu))
        lift = positive_lift(parted(Q.uu, least < most), DEFINITE)
        Q_uu = Q.uu + (lift + damping * largest(Q.uu)) * eye_u
        curvature = Q.uu.diagonal(dim1=0, dim2=1).movedim(-1, 0) + lift
        k, free = solve_box_qp(Q_uu, Q.u, least, most)
        K = -product(free_inverse(Q_uu, free), Q.ux)
        Qk = apply(Q_uu, k)
        cross = transposed_product(K, Q.ux)
        V_x = Q.x + transposed_apply(K, Qk + Q.u) + transposed_apply(Q.ux, k)
        V_xx = Q.xx + transposed_product(K, product(Q_uu, K)) + cross + cross.transpose(0, 1)
        decrease = -(k * (0.5 * Qk + Q.u)).sum(0, keepdim=True)
        return pack(V_x, symmetric(V_xx)), pack(
            k, K, curvature, decrease, lift.sum(0, keepdim=True), (lift * free).sum(0, keepdim=True)
        )

    final_x, final_xx = unpack(lq.final, *final_shapes(n))
    final_xx = final_xx + eye * lifted * dominance(final_xx, torch.zeros_like(final_x))
    inputs = torch.concatenate([lq.stages, *limits], 1)
    outputs = walk(step, pack(final_x, final_xx), inputs, reverse=True)[1]
    gains, curvature, decrease, *lifts = outputs.split([m + m * n, m, 1, 1, 1], 1)
    scaled = torch.minimum(torch.maximum(-gradient / curvature, below), above)
    flags = ((lift > 0).any(0).squeeze(0) for lift in lifts)
    slope = -(scaled * gradient).sum((0, 1))
    return Policy(gains.contiguous(), decrease.sum((0, 1)), slope, *flags)


def farthest(dtype: torch.dtype) -> float:
    """What stands for an infinite bound: finite, because a closed form may multiply it by zero."""
    return torch.finfo(dtype).max ** 0.25


def is_far(u: Float[Tensor, "*b"]) -> Bool[Tensor, "*b"]:
    """Which controls have run off as far as a control without bound can go."""
    return u.abs() >= ARRIVED * farthest(u.dtype)


def is_active(
    u: Float[Tensor, "*T m N"], gradient: Float[Tensor, "*T m N"], box: Float[Tensor, "2 m"]
) -> Bool[Tensor, "*T m N"]:
    """Which controls their bound holds: at it, with pressure on it."""
    lower, upper = box.unsqueeze(-1)
    return ((u <= lower) & (gradient > 0)) | ((u >= upper) & (gradient < 0)) | (lower == upper)


def solve_free(lq: LinearQuadratic, free: Float[Tensor, "T m N"], n: int) -> Stationary:
    """Stationary point with δx_0 = 0 and δu = 0 for the controls that are not free (0 in `free`).

    Nothing is shifted or damped, and the Hessian on the free controls may be indefinite. Controls,
    and combinations of them, in which it does not stand out of its rounding stay at zero as well: a
    minimum that is flat in them says nothing of where they go.
    """
    m = free.shape[1]
    eps = FLAT * n * torch.finfo(free.dtype).eps

    def backward(value: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        *parts, _, mask = unpack(row, *stage_shapes(n, m), (m,))
        after, extent = unpack(value, (n + n * n,), (n,))
        Q = _action(after, tuple(parts))
        own = parts[6].diagonal(dim1=0, dim2=1).movedim(-1, 0).abs()
        noise = eps * (own + transposed_apply(parts[1].abs(), extent).square())
        inverse = regular_inverse(Q.uu, mask > 0.5, noise + torch.finfo(free.dtype).tiny)
        k, K = -apply(inverse, Q.u), -product(inverse, Q.ux)
        V_x = Q.x + transposed_apply(Q.ux, k)
        V_xx = symmetric(Q.xx + transposed_product(Q.ux, K))
        extent = torch.maximum(extent, _extent(Q.xx))
        return pack(V_x, V_xx, extent), pack(k, K, after)

    def forward(x: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        k, K, V_x, V_xx, A, B = unpack(row, (m,), (m, n), *final_shapes(n), (n, n), (n, m))
        u = k + apply(K, x)
        following = apply(A, x) + apply(B, u)
        return following, pack(following, u, V_x + apply(V_xx, following))

    extent = _extent(unpack(lq.final, *final_shapes(n))[1])
    rows = torch.concatenate([lq.stages, free], 1)
    gains = walk(backward, pack(lq.final, extent), rows, reverse=True)[1]
    rows = torch.concatenate([gains, lq.stages[:, : n * (n + m)]], 1)
    start = torch.zeros_like(lq.final[:n])
    return Stationary(*walk(forward, start, rows)[1].split([n, m, n], 1))


def _extent(V_xx: Float[Tensor, "n n N"]) -> Float[Tensor, "n N"]:
    """Roots of the diagonal: a bound on the entries of a semidefinite matrix, by two factors."""
    return V_xx.diagonal(dim1=0, dim2=1).movedim(-1, 0).abs().sqrt()
