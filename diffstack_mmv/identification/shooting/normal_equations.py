"""Gauss-Newton equations of all tracks, and their unknowns as one row per track."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.shooting.block_arrowhead import BlockArrowhead
from diffstack_mmv.identification.shooting.condensing import CondensedJacobian
from diffstack_mmv.identification.shooting.problem import COMMAND_DIM, INITIAL_DIM, Unknowns


def stack_unknowns(unknowns: Unknowns) -> Float[Tensor, "N z"]:
    """One row per track: initial condition, then the rates in the order of time."""
    return torch.cat([unknowns.initial, unknowns.rates.flatten(1)], -1)


def unstack_unknowns(vector: Float[Tensor, "N z"], nodes: Float[Tensor, "N m s"]) -> Unknowns:
    """Undo `stack_unknowns`, with these nodes."""
    initial, rates = vector[:, :INITIAL_DIM], vector[:, INITIAL_DIM:]
    return Unknowns(initial, rates.unflatten(-1, (-1, COMMAND_DIM)), nodes)


def normal_equations(
    jacobian: CondensedJacobian,
    residual: Float[Tensor, "N T1 k"],
    unknowns: Unknowns,
    closing: Float[Tensor, "#N"] | None = None,
) -> BlockArrowhead:
    """Gauss-Newton equations of ½ |r|² + ½ |c|² + ½ |d|²; the prior of θ is not part of them.

    Args:
        jacobian: Of the residuals.
        residual: Residuals with the gaps as they are.
        unknowns: Where it was linearised.
        closing: Share of the gaps that the step closes; all by default.
    """
    local, shared = jacobian.local, jacobian.shared
    share = residual.new_ones(1) if closing is None else closing
    rows = (residual.flatten(1) + share.unsqueeze(-1) * jacobian.offset).unsqueeze(-1)
    identity = torch.eye(local.shape[-1], dtype=local.dtype)
    return BlockArrowhead(
        local=local.mT @ local + identity,
        cross=local.mT @ shared,
        shared=(shared.mT @ shared).sum(0),
        local_gradient=(local.mT @ rows).squeeze(-1) + stack_unknowns(unknowns),
        shared_gradient=(shared.mT @ rows).sum((0, 2)),
    )
