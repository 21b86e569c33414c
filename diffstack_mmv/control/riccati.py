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
from diffstack_mmv.control.box_qp import free_inverse, positive_shift, solve_box_qp

DEFINITE = 1e-6  # smallest eigenvalue of Q_uu relative to its largest entry, before it is shifted


class LinearQuadratic(NamedTuple):
    """min Σ ½ z'Hz + h'z over z_t = (δx_t, δu_t), subject to δx_{t+1} = A δx_t + B δu_t."""

    A: Float[Tensor, "T n n N"]
    B: Float[Tensor, "T n m N"]
    x: Float[Tensor, "T n N"]  # gradient of c_0 .. c_{T-1}
    u: Float[Tensor, "T m N"]
    xx: Float[Tensor, "T n n N"]
    ux: Float[Tensor, "T m n N"]
    uu: Float[Tensor, "T m m N"]
    final_x: Float[Tensor, "n N"]  # of c_T
    final_xx: Float[Tensor, "n n N"]

    def packed(self, *more: Float[Tensor, "T r N"]) -> Float[Tensor, "T R N"]:
        """All that a step of a recursion reads, in one tensor."""
        stages = (self.A, self.B, self.x, self.u, self.xx, self.ux, self.uu, *more)
        return torch.cat([stage.flatten(1, -2) for stage in stages], 1)


class Policy(NamedTuple):
    """Feedback δu_t = α k_t + K_t δx_t, and what the model promises for it."""

    k: Float[Tensor, "T m N"]
    K: Float[Tensor, "T m n N"]
    decrease: Float[Tensor, " N"]  # predicted decrease of the cost for α = 1
    shifted: Bool[Tensor, " N"]  # whether any Q_uu had to be made positive definite


class Stationary(NamedTuple):
    """Solution of an equality-constrained linear-quadratic problem."""

    x: Float[Tensor, "T n N"]  # δx_1 .. δx_T
    u: Float[Tensor, "T m N"]
    costate: Float[Tensor, "T n N"]  # of δx_1 .. δx_T


class _Action(NamedTuple):
    """Q function of one time, Q_uu still as it comes."""

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

    return walk(step, final_x, torch.cat([A.flatten(1, 2), x], 1), reverse=True)[1]


def _action(value: Tensor, row: Tensor, n: int, m: int) -> _Action:
    """Q_x = c_x + A'V_x and so on."""
    A, B, x, u, xx, ux, uu = unpack(row, (n, n), (n, m), (n,), (m,), (n, n), (m, n), (m, m))
    V_x, V_xx = unpack(value, (n,), (n, n))
    VA, VB = product(V_xx, A), product(V_xx, B)
    return _Action(
        x + transposed_apply(A, V_x),
        u + transposed_apply(B, V_x),
        xx + transposed_product(A, VA),
        ux + transposed_product(B, VA),
        symmetric(uu + transposed_product(B, VB)),
    )


def box_policy(
    lq: LinearQuadratic,
    lower: Float[Tensor, "T m N"],
    upper: Float[Tensor, "T m N"],
    damping: Float[Tensor, " N"],
) -> Policy:
    """Backward pass of control-limited DDP.

        Q_x = c_x + A'V_x,  Q_u = c_u + B'V_x,  Q_xx = c_xx + A'V_xx A,  Q_ux = c_ux + B'V_xx A,  Q_uu = c_uu + B'V_xx B
        k = argmin ½ k'Q_uu k + Q_u'k in the box,   K = -Q_uu⁻¹ Q_ux on the free controls, 0 on the others
        V_x = Q_x + K'(Q_uu k + Q_u) + Q_ux'k,  V_xx = Q_xx + K'Q_uu K + K'Q_ux + Q_ux'K

    with Q_uu + μ max|Q_uu| I, shifted further where it is not positive definite. The damping counts as a part of the
    cost of δu, so that the policy minimises one convex model and is a direction of descent. Source: [TASSA].

    Args:
        lq: The model around the present trajectory.
        lower: Lower bound minus present control.
        upper: Upper bound minus present control.
        damping: μ of each problem, dimensionless.
    """
    (_, n, m, N) = lq.B.shape
    eye = torch.eye(m, dtype=lq.B.dtype, device=lq.B.device).unsqueeze(-1)

    def step(value: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        Q = _action(value, row[: -2 * m], n, m)
        shift = positive_shift(Q.uu, DEFINITE)
        Q_uu = Q.uu + (shift + damping * Q.uu.abs().amax((0, 1))) * eye
        k, free = solve_box_qp(Q_uu, Q.u, row[-2 * m : -m], row[-m:])
        K = -product(free_inverse(Q_uu, free), Q.ux)
        Qk = apply(Q_uu, k)
        cross = transposed_product(K, Q.ux)
        V_x = Q.x + transposed_apply(K, Qk + Q.u) + transposed_apply(Q.ux, k)
        V_xx = Q.xx + transposed_product(K, product(Q_uu, K)) + cross + cross.transpose(0, 1)
        decrease = -(k * (0.5 * Qk + Q.u)).sum(0, keepdim=True)
        return pack(V_x, symmetric(V_xx)), pack(k, K, decrease, shift.unsqueeze(0))

    rows = walk(step, pack(lq.final_x, lq.final_xx), lq.packed(lower, upper), reverse=True)[1]
    k, K, decrease, shift = rows.split([m, m * n, 1, 1], 1)
    return Policy(k, K.unflatten(1, (m, n)), decrease.sum((0, 1)), (shift > 0).any(0).squeeze(0))


def solve_free(lq: LinearQuadratic, free: Float[Tensor, "T m N"]) -> Stationary:
    """Stationary point with δx_0 = 0 and the controls that are not free (0 in `free`) held at zero.

    The Hessian has to be invertible on the free controls, not definite: nothing is shifted or damped.
    """
    (_, n, m, N) = lq.B.shape

    def backward(value: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        Q = _action(value, row[:-m], n, m)
        inverse = free_inverse(Q.uu, row[-m:] > 0.5)
        k, K = -apply(inverse, Q.u), -product(inverse, Q.ux)
        V_x = Q.x + transposed_apply(Q.ux, k)
        V_xx = symmetric(Q.xx + transposed_product(Q.ux, K))
        return pack(V_x, V_xx), pack(k, K, value)

    def forward(x: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        k, K, V_x, V_xx, A, B = unpack(row, (m,), (m, n), (n,), (n, n), (n, n), (n, m))
        u = k + apply(K, x)
        following = apply(A, x) + apply(B, u)
        return following, pack(following, u, V_x + apply(V_xx, following))

    gains = walk(backward, pack(lq.final_x, lq.final_xx), lq.packed(free), reverse=True)[1]
    rows = torch.cat([gains, lq.A.flatten(1, 2), lq.B.flatten(1, 2)], 1)
    return Stationary(*walk(forward, torch.zeros_like(lq.final_x), rows)[1].split([n, m, n], 1))
