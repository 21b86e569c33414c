"""What the linearised segments promise for a step, and the merit that it is judged by.

A step moves θ and the unknowns of single shooting; the nodes follow by the linearised equations of
continuity, of whose gaps it closes a share. Less is closed the more it is damped, so that damping
shortens the whole step. It is judged by the exact penalty f + Σ w |gap|, with one weight per
component of each gap: the multiplier of its continuity, softened as Powell does.

Source: Powell, A fast algorithm for nonlinearly constrained optimization calculations, 1978.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.linearisation import Jacobian, Simulated, flat, unflat
from diffstack_mmv.identification.problem import Unknowns
from diffstack_mmv.identification.segments import node_times


class Step(NamedTuple):
    """A step of θ and of the unknowns of each track."""

    own: Float[Tensor, "N z"]
    shared: Float[Tensor, " p"]
    closing: Float[Tensor, "#N"]  # share of the gaps that it closes


class Outlook(NamedTuple):
    """Where a step leads if the segments are linear."""

    unknowns: Unknowns
    cost: Float[Tensor, " N"]
    multipliers: Float[Tensor, "N m s"]  # change of that cost by the state at each node


def closing_share(damping: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Share of the gaps that a damped step closes: that of a single damped unknown."""
    return 1 / (1 + damping)


def foresee(jacobian: Jacobian, now: Simulated, unknowns: Unknowns, step: Step) -> Outlook:
    """Follow a step along the linearisation.

    Args:
        jacobian: Derivatives here.
        now: Simulated here.
        unknowns: Here.
        step: The step; θ may have no column in the Jacobian, and none in the step.
    """
    closing = step.closing.expand(len(step.own)).unsqueeze(-1)
    moved = (jacobian.own @ step.own.unsqueeze(-1)).squeeze(-1)
    change = moved + jacobian.shared @ step.shared + closing * jacobian.offset
    residual = now.residual + change.view_as(now.residual)
    vector = flat(unknowns) + step.own
    shared = step.shared.expand(len(step.own), -1)
    columns = torch.cat([shared, step.own, closing], -1)
    nodes = unknowns.nodes + (jacobian.nodes @ columns[:, None, :, None]).squeeze(-1)
    cost = 0.5 * (residual.square().sum((1, 2)) + vector.square().sum(-1))
    return Outlook(unflat(vector, nodes), cost, multipliers(jacobian, residual, nodes.shape[1]))


def multipliers(
    jacobian: Jacobian, residual: Float[Tensor, "N T1 k"], nodes: int
) -> Float[Tensor, "N m s"]:
    """Gradient of what follows a node by its state: λ_t = R_tᵀ r_t + A_tᵀ λ_{t+1}, A dynamics."""
    steps, stages = jacobian.steps, residual.shape[1]
    pulled = (steps.residual_state.mT @ residual.unsqueeze(-1)).squeeze(-1)
    found = [pulled[:, -1]]
    for time in range(stages - 2, 0, -1):
        earlier = (steps.state[:, time].mT @ found[-1].unsqueeze(-1)).squeeze(-1)
        found.append(pulled[:, time] + earlier)
    first = torch.zeros_like(found[-1])
    return torch.stack([first, *reversed(found)], 1)[:, node_times(stages, nodes)]


def penalty_weights(
    before: Float[Tensor, "N m s"], multipliers: Float[Tensor, "N m s"]
) -> Float[Tensor, "N m s"]:
    """Weights that no multiplier exceeds, and that forget earlier ones by halves."""
    size = multipliers.abs()
    return torch.maximum(size, 0.5 * (before + size))


def merit(simulated: Simulated, weights: Float[Tensor, "N m s"]) -> Float[Tensor, " N"]:
    """Cost of each track with the penalty of its gaps."""
    return simulated.cost + (weights * simulated.gap.abs()).sum((1, 2))
