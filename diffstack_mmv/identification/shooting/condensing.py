"""Derivatives of whole tracks from those of single steps, nodes eliminated.

The chain rule is accumulated over time. Where an interval does not end at the node of the next
one, the gap enters the chain as a column of its own. So the nodes are eliminated exactly by
the linearised equations of continuity, and what is left are the unknowns of single shooting.

Source: Bock and Plitt, A multiple shooting algorithm for direct solution of optimal control
problems, IFAC World Congress 1984.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from diffstack_mmv.identification.shooting.intervals import node_times
from diffstack_mmv.identification.shooting.problem import COMMAND_DIM, INITIAL_DIM


class StepJacobian(NamedTuple):
    """Derivatives of single steps."""

    state: Float[Tensor, "N T1 s s"]
    rates: Float[Tensor, "N T1 s 2"]
    shared: Float[Tensor, "N T1 s p"]
    residual_state: Float[Tensor, "N T1 k s"]
    residual_shared: Float[Tensor, "N T1 k p"]


class CondensedJacobian(NamedTuple):
    """Derivatives of the residuals of each track by its unknowns and by θ, gaps closed."""

    local: Float[Tensor, "N r z"]
    shared: Float[Tensor, "N r p"]
    offset: Float[Tensor, "N r"]  # what closing all gaps adds to the residuals
    nodes: Float[Tensor, "N m s c"]  # of the nodes by θ, the unknowns, and the share closed
    mask: Float[Tensor, "N m"]  # one for nodes on a track, zero for those in the padding
    steps: StepJacobian


def condense(
    steps: StepJacobian,
    first: Float[Tensor, "N s c"],
    gap: Float[Tensor, "N m s"],
    mask: Float[Tensor, "N m"],
) -> CondensedJacobian:
    """Derivatives of whole tracks.

    Args:
        steps: Those of single steps.
        first: Those of the first state by θ and the initial condition.
        gap: End of each shooting interval minus the node after it.
        mask: One for nodes on a track; those in the padding stay where they are.
    """
    stages, count = steps.state.shape[1], steps.shared.shape[-1]
    # columns: θ, initial condition, rates, share of the gaps that is closed
    chain = pad(first, (0, COMMAND_DIM * (stages - 1) + 1))
    stages_of_nodes = range(stages)[node_times(stages, gap.shape[1])]
    rows, at_nodes = [], [chain.new_zeros(len(chain), 0, *chain.shape[1:])]
    for time in range(stages):
        if time in stages_of_nodes:
            node = stages_of_nodes.index(time)
            chain[..., -1] += gap[:, node]
            chain = chain * mask[:, node, None, None]
            at_nodes.append(chain.unsqueeze(1))
        row = steps.residual_state[:, time] @ chain
        row[..., :count] += steps.residual_shared[:, time]
        rows.append(row)
        if time < stages - 1:
            chain = steps.state[:, time] @ chain
            chain[..., :count] += steps.shared[:, time]
            column = count + INITIAL_DIM + COMMAND_DIM * time
            chain[..., column : column + COMMAND_DIM] += steps.rates[:, time]
    whole = torch.cat(rows, 1)
    local, shared, offset = whole[..., count:-1], whole[..., :count], whole[..., -1]
    return CondensedJacobian(local, shared, offset, torch.cat(at_nodes, 1), mask, steps)


def node_corrections(
    jacobian: CondensedJacobian, gap: Float[Tensor, "N m s"]
) -> Float[Tensor, "N m s"]:
    """Moves of the nodes that close gaps: e_{t+1} = A_t e_t, plus the gap at each node."""
    steps, (stages, count) = jacobian.steps, (jacobian.steps.state.shape[1], gap.shape[1])
    stages_of_nodes = range(stages)[node_times(stages, count)]
    moves = [torch.zeros_like(gap[:, :0])]
    carried = gap.new_zeros(len(gap), gap.shape[-1])
    for node in range(count):
        for time in range(stages_of_nodes[node] - stages_of_nodes.step, stages_of_nodes[node]):
            carried = (steps.state[:, time] @ carried.unsqueeze(-1)).squeeze(-1)
        carried = (carried + gap[:, node]) * jacobian.mask[:, node, None]
        moves.append(carried.unsqueeze(1))
    return torch.cat(moves, 1)


def continuity_multipliers(
    jacobian: CondensedJacobian, residual: Float[Tensor, "N T1 k"], nodes: int
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
