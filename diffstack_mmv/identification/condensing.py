"""Derivatives of whole tracks from those of single steps, nodes eliminated.

The chain rule is accumulated over time. Where a segment ends beside the node that the next one
begins at, the gap enters the chain as a column of its own. So the nodes are eliminated exactly by
the linearised equations of continuity, and what is left are the unknowns of single shooting.

Source: Bock and Plitt, A multiple shooting algorithm for direct solution of optimal control
problems, IFAC World Congress 1984.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from diffstack_mmv.identification.problem import INTENTION, PLACEMENT
from diffstack_mmv.identification.segments import node_times


class StepJacobian(NamedTuple):
    """Derivatives of single steps."""

    state: Float[Tensor, "N T1 s s"]
    rates: Float[Tensor, "N T1 s 2"]
    shared: Float[Tensor, "N T1 s p"]
    residual_state: Float[Tensor, "N T1 k s"]
    residual_shared: Float[Tensor, "N T1 k p"]


class Jacobian(NamedTuple):
    """Derivatives of the residuals of each track by its unknowns and by θ, gaps closed."""

    own: Float[Tensor, "N r z"]
    shared: Float[Tensor, "N r p"]
    offset: Float[Tensor, "N r"]  # what closing all gaps adds to the residuals
    nodes: Float[Tensor, "N m s c"]  # of the nodes by θ, the unknowns, and the share closed
    live: Float[Tensor, "N m"]  # one for nodes on a track, zero for those in the padding
    steps: StepJacobian


def condensed(
    steps: StepJacobian,
    begun: Float[Tensor, "N s c"],
    gap: Float[Tensor, "N m s"],
    live: Float[Tensor, "N m"],
) -> Jacobian:
    """Derivatives of whole tracks.

    Args:
        steps: Those of single steps.
        begun: Those of the first state by θ and the placement.
        gap: End of each segment minus the node after it.
        live: One for nodes on a track; those in the padding stay where they are.
    """
    stages, count = steps.state.shape[1], steps.shared.shape[-1]
    # columns: θ, placement, rates, share of the gaps that is closed
    chain = pad(begun, (0, INTENTION * (stages - 1) + 1))
    met = range(stages)[node_times(stages, gap.shape[1])]
    rows, at_nodes = [], [chain.new_zeros(len(chain), 0, *chain.shape[1:])]
    for time in range(stages):
        if time in met:
            node = met.index(time)
            chain[..., -1] += gap[:, node]
            chain = chain * live[:, node, None, None]
            at_nodes.append(chain.unsqueeze(1))
        row = steps.residual_state[:, time] @ chain
        row[..., :count] += steps.residual_shared[:, time]
        rows.append(row)
        if time < stages - 1:
            chain = steps.state[:, time] @ chain
            chain[..., :count] += steps.shared[:, time]
            first = count + PLACEMENT + INTENTION * time
            chain[..., first : first + INTENTION] += steps.rates[:, time]
    whole = torch.cat(rows, 1)
    own, shared, offset = whole[..., count:-1], whole[..., :count], whole[..., -1]
    return Jacobian(own, shared, offset, torch.cat(at_nodes, 1), live, steps)


def closing_moves(jacobian: Jacobian, gap: Float[Tensor, "N m s"]) -> Float[Tensor, "N m s"]:
    """Moves of the nodes that close gaps: e_{t+1} = A_t e_t, plus the gap at each node."""
    steps, (stages, count) = jacobian.steps, (jacobian.steps.state.shape[1], gap.shape[1])
    met = range(stages)[node_times(stages, count)]
    moves = [torch.zeros_like(gap[:, :0])]
    carried = gap.new_zeros(len(gap), gap.shape[-1])
    for node in range(count):
        for time in range(met[node] - met.step, met[node]):
            carried = (steps.state[:, time] @ carried.unsqueeze(-1)).squeeze(-1)
        carried = (carried + gap[:, node]) * jacobian.live[:, node, None]
        moves.append(carried.unsqueeze(1))
    return torch.cat(moves, 1)


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
