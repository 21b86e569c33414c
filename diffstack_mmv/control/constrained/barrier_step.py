"""The Newton step of the barrier problem, on a convex Hessian."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.constrained.barrier import Barrier, BarrierResidual, Interior
from diffstack_mmv.control.constrained.condensed import (
    Condensed,
    assemble,
    chunks,
    condense,
    is_convex,
)
from diffstack_mmv.control.constrained.local import Local

SHIFT, SHIFT_GROWTH, SHIFTS = 1e-4, 8.0, 14  # of the Hessian, relative to its diagonal


class Newton(NamedTuple):
    """A Newton step, and the shift of the Hessian that it took."""

    step: Interior
    shift: Float[Tensor, "*b"]


def newton(
    barrier: Barrier,
    local: Local,
    point: Interior,
    residual: BarrierResidual,
    mu: Float[Tensor, "*b"],
    shift: Float[Tensor, "*b"],
    which: Bool[Tensor, "*b"],
) -> Newton:
    """Newton step on the optimality conditions of the problems `which`, zero for the others.

    Slacks: dz = Σ (J δ) + c with Σ = z / (s + z σ / (p + w₂ σ)), p = w₁ + w₂ σ - z, the terms in σ
    for soft rows only.
    """
    rows = barrier.rows
    level, scale = mu[..., None, None], barrier.scale[..., None, None]
    spare, quadratic = barrier.spare(point), scale * rows.quadratic
    give = torch.where(barrier.yields, 1 / (spare + quadratic * point.sigma), 0.0)
    stiff = rows.applies.to(point.s) / (point.s + point.z * point.sigma * give)
    pushed = (level - spare * point.sigma) * give  # of σ, at dz = 0
    constant = stiff * (level - point.s * point.z + point.z * (residual.unequal - pushed))
    stiff = stiff * point.z
    below, above = barrier.gaps(point.u)
    around = point.lower / below + point.upper / above
    push = level / below - level / above
    parts = (stiff, constant, around, push, point.lower - point.upper, *residual)
    flat = [barrier.problem.flat(part) for part in parts]
    found, shifted = _solve(barrier, local, flat, shift.flatten().clone(), which.flatten())
    dx, du, moved, dy = (barrier.problem.unflat(part) for part in found)
    dz = stiff * moved + constant
    dsigma = torch.where(barrier.yields, pushed + point.sigma * give * dz, 0.0)
    ds = torch.where(rows.applies, dsigma - residual.unequal - moved, 0.0)
    lower = level / below - point.lower - point.lower / below * du
    upper = level / above - point.upper + point.upper / above * du
    step = Interior(dx, du, ds, dsigma, dz, dy, lower, upper)
    return Newton(step, shifted.view(mu.shape))


def _solve(
    barrier: Barrier, local: Local, flat: list[Tensor], shift: Tensor, which: Tensor
) -> tuple[list[Tensor], Tensor]:
    """δx, δu, J δ of the inequalities and δy, chunk by chunk."""
    N, T1, inequalities = flat[0].shape
    (T, n), m, E = local.B.shape[1:3], local.B.shape[3], flat[-1].shape[-1]
    shapes = (T1, n), (T, m), (T1, inequalities), (T1, E)
    found = [local.B.new_zeros(N, *shape) for shape in shapes]
    for index in chunks(which):
        some = [part[index] for part in flat]
        parts, shift[index] = _solve_some(barrier, local.select(index), some, shift[index])
        for whole, part in zip(found, parts, strict=True):
            whole[index] = part
    return found, shift


def _solve_some(
    barrier: Barrier, local: Local, flat: list[Tensor], shift: Tensor
) -> tuple[list[Tensor], Tensor]:
    stiff, constant, around, push, _, defect, _, equal = flat
    condensed = condense(local)
    N, T1, n, P = condensed.sensitivity.shape
    offset = _offset(local, defect)
    rows = condensed.jacobian.view(N, T1, -1, P)
    J = rows[:, :, barrier.rows.column] * barrier.rows.sign[:, None]
    along = (local.values_x @ offset.unsqueeze(-1)).squeeze(-1)
    drift = along[..., barrier.rows.column] * barrier.rows.sign
    J = J.flatten(1, 2)
    pressed = (constant + stiff * drift).flatten(1)
    weight = stiff.flatten(1)
    hessian = condensed.hessian + J.mT @ (weight.unsqueeze(-1) * J)
    hessian = hessian + torch.diag_embed(around.flatten(1))
    curved = (local.xx @ offset.unsqueeze(-1)).flatten(1)
    bent = (local.ux @ offset[:, :-1].unsqueeze(-1)).flatten(1)
    G = condensed.sensitivity
    right = push.flatten(1) - local.gradient.flatten(1) - bent
    right = right - (G.flatten(1, 2).mT @ curved.unsqueeze(-1)).squeeze(-1)
    right = right - (J.mT @ pressed.unsqueeze(-1)).squeeze(-1)
    H = rows[:, :, barrier.rows.equality].flatten(1, 2)
    wanted = -(equal + along[..., barrier.rows.equality]).flatten(1)
    low, high = barrier.problem.bounds
    free = (low < high).repeat(N, P // len(low))
    diagonal = condensed.hessian.diagonal(dim1=1, dim2=2).abs()
    diagonal = torch.maximum(diagonal, 1e-3 * diagonal.mean(1, keepdim=True))
    active = torch.ones_like(wanted, dtype=torch.bool) & (H.abs().amax(-1) > 0)
    whole = condensed._replace(hessian=hessian, jacobian=H)
    shift = _lifting(whole, diagonal, free, active, shift)
    whole = whole._replace(hessian=hessian + torch.diag_embed(shift.unsqueeze(1) * diagonal))
    system = assemble(whole, free, active, torch.zeros_like(wanted))
    du, dy = system.solve(right, wanted)
    dx = (G @ du[:, None, :, None]).squeeze(-1) + offset
    moved = (J @ du.unsqueeze(-1)).view(drift.shape) + drift
    return [dx, du.view(N, T1 - 1, -1), moved, dy.view(equal.shape)], shift


def _lifting(
    condensed: Condensed, diagonal: Tensor, free: Tensor, active: Tensor, shift: Tensor
) -> Tensor:
    """A multiple of the diagonal, from the given one on, with which the Hessian is convex."""
    shift, bad = shift.clone(), torch.arange(len(shift), device=shift.device)
    for _ in range(SHIFTS):
        part = Condensed(*(matrix[bad] for matrix in condensed))
        lift = torch.diag_embed(shift[bad].unsqueeze(1) * diagonal[bad])
        part, rows = part._replace(hessian=part.hessian + lift), active[bad]
        bad = bad[~is_convex(part, free[bad], rows, torch.zeros_like(rows, dtype=shift.dtype))]
        if len(bad) == 0:
            break
        more = torch.where(shift > 0, shift * SHIFT_GROWTH, torch.full_like(shift, SHIFT))
        shift[bad] = more[bad]
    return shift


def _offset(local: Local, defect: Tensor) -> Tensor:
    """Where the linear dynamics lead with the controls unchanged, to close the defects."""
    offset = [torch.zeros_like(defect[:, 0])]
    for t in range(defect.shape[1]):
        offset.append((local.A[:, t] @ offset[-1].unsqueeze(-1)).squeeze(-1) + defect[:, t])
    return torch.stack(offset, 1)
