"""A step of multiple shooting: what the linearised segments promise for it, and what it keeps.

A step moves θ and the unknowns of single shooting; the nodes follow by the linearised equations of
continuity, of whose gaps it closes a share. Less is closed the more it is damped, so that damping
shortens the whole step. It is judged by the exact penalty f + Σ w |gap|, with one weight per
component of each gap: the multiplier of its continuity, softened as Powell does. Nodes that miss
each other by more than was foreseen are corrected once along the same linearisation, lest the
penalty refuse good steps for gaps of second order (the Maratos effect).

Source: Powell, A fast algorithm for nonlinearly constrained optimization calculations, 1978.
"""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.identification.condensing import Jacobian, closing_moves, multipliers
from diffstack_mmv.identification.linearisation import (
    Simulated,
    Tracker,
    flat,
    unflat,
)
from diffstack_mmv.identification.problem import Problem, Unknowns


class Step(NamedTuple):
    """A step of θ and of the unknowns of each track."""

    own: Float[Tensor, "N z"]
    shared: Float[Tensor, " p"]
    closing: Float[Tensor, "#N"]  # share of the gaps that it closes


class Linearised(NamedTuple):
    """Tracks cut into segments, and the derivatives here."""

    unknowns: Unknowns
    simulated: Simulated
    jacobian: Jacobian


class Outlook(NamedTuple):
    """Where a step leads if the segments are linear."""

    unknowns: Unknowns
    cost: Float[Tensor, " N"]
    multipliers: Float[Tensor, "N m s"]  # change of that cost by the state at each node


def closing_share(damping: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Share of the gaps that a damped step closes: that of a single damped unknown."""
    return 1 / (1 + damping)


class Trial(NamedTuple):
    """What became of a step, track by track."""

    unknowns: Unknowns
    simulated: Simulated
    weights: Float[Tensor, "N m s"]  # of the gaps in the merit
    promised: Float[Tensor, " N"]  # decrease of the merit if the segments were linear
    decrease: Float[Tensor, " N"]  # of the merit


def attempt(
    tracker: Tracker,
    theta: Float[Tensor, " p"],
    problem: Problem,
    here: Linearised,
    step: Step,
    weights: Float[Tensor, "N m s"],
) -> Trial:
    """Take a step, and correct the nodes where that is better.

    Args:
        tracker: Model and residuals.
        theta: θ after the step.
        problem: The tracks.
        here: Where the step begins.
        step: The step.
        weights: Of the gaps in the merit before.
    """
    outlook = foresee(here, step)
    weights = penalty_weights(weights, outlook.multipliers)
    begun = merit(here.simulated, weights)
    left = (1 - step.closing)[:, None, None] * here.simulated.gap
    promised = begun - merit(here.simulated._replace(cost=outlook.cost, gap=left), weights)
    first = tracker.simulate(theta, problem, outlook.unknowns)
    surplus = first.gap - left
    nodes = outlook.unknowns.nodes + closing_moves(here.jacobian, surplus)
    second = outlook.unknowns._replace(nodes=nodes)
    corrected = tracker.simulate(theta, problem, second)
    better = merit(corrected, weights) < merit(first, weights)
    unknowns, simulated = keep(better, second, outlook.unknowns), keep(better, corrected, first)
    return Trial(unknowns, simulated, weights, promised, begun - merit(simulated, weights))


def keep(better: Bool[Tensor, " N"], new: Any, old: Any) -> Any:
    """Per track, the new record where it is better, else the old one."""
    pairs = zip(new, old, strict=True)
    return type(new)(
        *(torch.where(better.reshape(-1, *[1] * (n.dim() - 1)), n, o) for n, o in pairs)
    )


def foresee(here: Linearised, step: Step) -> Outlook:
    """Follow a step along the linearisation; θ may have no column there, and none in the step."""
    unknowns, now, jacobian = here
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


def penalty_weights(
    before: Float[Tensor, "N m s"], multipliers: Float[Tensor, "N m s"]
) -> Float[Tensor, "N m s"]:
    """Weights that no multiplier exceeds, and that forget earlier ones by halves."""
    size = multipliers.abs()
    return torch.maximum(size, 0.5 * (before + size))


def merit(simulated: Simulated, weights: Float[Tensor, "N m s"]) -> Float[Tensor, " N"]:
    """Cost of each track with the penalty of its gaps."""
    return simulated.cost + (weights * simulated.gap.abs()).sum((1, 2))
