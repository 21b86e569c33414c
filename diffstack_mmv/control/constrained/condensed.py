"""The constrained linear-quadratic problem in its controls alone, solved densely.

With the sensitivities G_t = ∂x_t/∂u of the linear dynamics the Hessian of the Lagrangian and the
Jacobian of the constraints become a matrix M over all T·m controls and rows J. Controls on a bound
are held there. What is left is one symmetric system per problem,

    [ M  J' ] [δu]
    [ J  -D ] [δν]

over the free controls and the active rows; D is 1 / price where a row may give way. Problems
differ in both numbers: the system is padded with rows of the identity to the size of the largest.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.control.constrained.local import Local

REFINEMENTS = 3
CHUNK = 256  # problems that are solved densely at a time: bounds the memory


def chunks(which: Bool[Tensor, " N"]) -> list[Int[Tensor, " k"]]:
    """Positions of the chosen problems, some at a time."""
    return [index for index in which.nonzero().squeeze(-1).split(CHUNK) if len(index)]


class Condensed(NamedTuple):
    """A quadratic model in the controls, P = T·m of them, with R = (T+1)·K rows of constraints."""

    hessian: Float[Tensor, "N P P"]
    jacobian: Float[Tensor, "N R P"]
    sensitivity: Float[Tensor, "N T1 n P"]


def condense(local: Local) -> Condensed:
    """Eliminate the states."""
    G = sensitivities(local.A, local.B)
    N, T1, n, P = G.shape
    T, m = T1 - 1, P // (T1 - 1)
    whole = (local.xx @ G).reshape(N, T1 * n, P)
    mixed = (local.ux @ G[:, :-1]).reshape(N, T, m, P)
    for t in range(T):
        mixed[:, t, :, t * m : (t + 1) * m] += 0.5 * local.uu[:, t]
    cross = mixed.reshape(N, P, P)
    hessian = G.reshape(N, T1 * n, P).mT @ whole + cross + cross.mT
    jacobian = _rows_along(G, local.values_x, local.values_u)
    return Condensed(0.5 * (hessian + hessian.mT), jacobian, G)


def sensitivities(
    A: Float[Tensor, "N T n n"], B: Float[Tensor, "N T n m"]
) -> Float[Tensor, "N T1 n P"]:
    """∂x_t/∂u_s of the linear dynamics."""
    N, T, n, m = B.shape
    G = B.new_zeros(N, T + 1, n, T * m)
    for t in range(T):
        G[:, t + 1] = A[:, t] @ G[:, t]
        G[:, t + 1, :, t * m : (t + 1) * m] = B[:, t]
    return G


def _rows_along(G: Tensor, values_x: Tensor, values_u: Tensor) -> Tensor:
    m, own = values_u.shape[-1], values_x @ G
    for t in range(values_u.shape[1]):
        own[:, t, :, t * m : (t + 1) * m] += values_u[:, t]
    return own.flatten(1, 2)


class System(NamedTuple):
    """A factorised system, scaled so that its entries are of the order of one."""

    matrix: Float[Tensor, "N S S"]
    factor: Float[Tensor, "N S S"]  # of the matrix with a small shift on the rows of constraints
    pivots: Int[Tensor, "N S"]
    scale: Float[Tensor, "N S"]
    free: Bool[Tensor, "N P"]
    index: Int[Tensor, "N H"]  # active rows, filled up with others
    active: Bool[Tensor, "N H"]

    def solve(
        self, of_u: Float[Tensor, "N P"], of_rows: Float[Tensor, "N R"]
    ) -> tuple[Float[Tensor, "N P"], Float[Tensor, "N R"]]:
        """δu and δν for a right-hand side; zero for controls on a bound and inactive rows.

        The shift of the factorised matrix decides between the multipliers of rows that depend on
        one another; refinement takes its effect away from all else.
        """
        chosen = of_rows.gather(1, self.index)
        wanted = torch.cat(
            [
                torch.where(self.free, of_u, torch.zeros_like(of_u)),
                torch.where(self.active, chosen, torch.zeros_like(chosen)),
            ],
            1,
        )
        wanted = (wanted * self.scale).unsqueeze(-1)
        found = torch.linalg.lu_solve(self.factor, self.pivots, wanted)
        for _ in range(REFINEMENTS):
            error = wanted - self.matrix @ found
            found = found + torch.linalg.lu_solve(self.factor, self.pivots, error)
        du, chosen = (found.squeeze(-1) * self.scale).split([of_u.shape[1], self.index.shape[1]], 1)
        return du, torch.zeros_like(of_rows).scatter(1, self.index, chosen)


class _Scaled(NamedTuple):
    """Parts of a system with a diagonal of ones, and what they were multiplied by."""

    M: Float[Tensor, "N P P"]
    J: Float[Tensor, "N H P"]
    D: Float[Tensor, "N H"]
    scale: Float[Tensor, "N S"]
    index: Int[Tensor, "N H"]
    active: Bool[Tensor, "N H"]


def _scaled(condensed: Condensed, free: Tensor, active: Tensor, compliance: Tensor) -> _Scaled:
    most = int(active.sum(1).amax()) if active.numel() else 0
    index = active.to(torch.uint8).argsort(dim=1, descending=True, stable=True)[:, :most]
    chosen = active.gather(1, index)
    rows = condensed.jacobian.gather(1, index.unsqueeze(-1).expand(-1, -1, free.shape[1]))
    M, J = _held_out(condensed.hessian, rows, free, chosen)
    scale_u = _inverse_root(M.diagonal(dim1=1, dim2=2).abs())
    M, J = M * scale_u.unsqueeze(1) * scale_u.unsqueeze(2), J * scale_u.unsqueeze(1)
    scale_r = _inverse_root(J.square().sum(-1))
    D = compliance.gather(1, index) * scale_r.square()
    D = torch.where(chosen, D, torch.ones_like(D))
    scale = torch.cat([scale_u, scale_r], 1)
    return _Scaled(M, J * scale_r.unsqueeze(-1), D, scale, index, chosen)


def assemble(
    condensed: Condensed,
    free: Bool[Tensor, "N P"],
    active: Bool[Tensor, "N R"],
    compliance: Float[Tensor, "N R"],
) -> System:
    """Factorise the system of the free controls and the active rows; `compliance` is D."""
    M, J, D, scale, index, chosen = _scaled(condensed, free, active, compliance)
    top, bottom = torch.cat([M, J.mT], 2), torch.cat([J, -torch.diag_embed(D)], 2)
    matrix = torch.cat([top, bottom], 1).nan_to_num(0.0, 0.0, 0.0)
    shift = torch.zeros_like(scale)
    shift[:, M.shape[1] :] = torch.finfo(M.dtype).eps ** 0.75
    factor, pivots, _ = torch.linalg.lu_factor_ex(matrix - torch.diag_embed(shift))
    return System(matrix, factor, pivots, scale, free, index, chosen)


def is_convex(
    condensed: Condensed,
    free: Bool[Tensor, "N P"],
    active: Bool[Tensor, "N R"],
    compliance: Float[Tensor, "N R"],
) -> Bool[Tensor, " N"]:
    """Where M is positive definite along the active rows: with a high price on leaving them."""
    M, J, D, *_ = _scaled(condensed, free, active, compliance)
    M = M + J.mT @ (J / (D + torch.finfo(M.dtype).eps ** 0.375).unsqueeze(-1))
    finite = M.isfinite().flatten(1).all(1)
    return finite & (torch.linalg.cholesky_ex(M.nan_to_num(0.0, 0.0, 0.0))[1] == 0)


def _held_out(M: Tensor, J: Tensor, free: Tensor, active: Tensor) -> tuple[Tensor, Tensor]:
    """The matrices with controls on a bound and idle rows cut out, ones on the diagonal instead.

    A control that changes neither cost nor rows is cut out as well: it stays where it is.
    """
    free = free & ~((M == 0).all(2) & (J == 0).all(1))
    both = free.unsqueeze(1) & free.unsqueeze(2)
    M = torch.where(both, M, torch.diag_embed((~free).to(M.dtype)))
    return M, torch.where(active.unsqueeze(2) & free.unsqueeze(1), J, torch.zeros_like(J))


def _inverse_root(size: Tensor) -> Tensor:
    """1 / √size, one where the size is zero or not finite."""
    usable = (size > torch.finfo(size.dtype).tiny) & size.isfinite()
    return torch.where(usable, size, torch.ones_like(size)).rsqrt()
