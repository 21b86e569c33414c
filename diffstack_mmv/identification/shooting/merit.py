"""The merit function of multiple shooting, and the decrease of it that a step predicts and has.

A step moves θ and the unknowns of single shooting; the nodes follow by the linearised equations of
continuity, of whose gaps it closes a share. Less is closed the more it is damped, so that damping
shortens the whole step. It is judged by the exact penalty f + Σ w |gap|, with one weight per
component of each gap: the multiplier of its continuity, relaxed as Powell does. Nodes that miss
each other by more than was predicted are corrected once along the same linearisation, so
that the penalty does not refuse good steps for gaps of second order (the Maratos effect).

Source: Powell, A fast algorithm for nonlinearly constrained optimization calculations, 1978.
"""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.identification.shooting.condensing import (
    CondensedJacobian,
    continuity_multipliers,
    node_corrections,
)
from diffstack_mmv.identification.shooting.linearisation import TrackSimulation, TrackSimulator
from diffstack_mmv.identification.shooting.normal_equations import stack_unknowns, unstack_unknowns
from diffstack_mmv.identification.shooting.problem import TrackingProblem, Unknowns


class ShootingStep(NamedTuple):
    """A step of θ and of the unknowns of each track."""

    local: Float[Tensor, "N z"]
    shared: Float[Tensor, " p"]
    closing: Float[Tensor, "#N"]  # share of the gaps that it closes


class LinearisedTracks(NamedTuple):
    """Tracks divided into shooting intervals, with the derivatives at this point."""

    unknowns: Unknowns
    simulated: TrackSimulation
    jacobian: CondensedJacobian


class LinearPrediction(NamedTuple):
    """Result of a step if the dynamics were linear."""

    unknowns: Unknowns
    cost: Float[Tensor, " N"]
    multipliers: Float[Tensor, "N m s"]  # change of that cost by the state at each node


def gap_closure(damping: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Share of the gaps that a damped step closes: that of a single damped unknown."""
    return 1 / (1 + damping)


class StepTrial(NamedTuple):
    """Result of a step, track by track."""

    unknowns: Unknowns
    simulated: TrackSimulation
    weights: Float[Tensor, "N m s"]  # of the gaps in the merit function
    predicted_decrease: Float[Tensor, " N"]  # of the merit, if the dynamics were linear
    decrease: Float[Tensor, " N"]  # of the merit, as simulated


def try_step(
    simulator: TrackSimulator,
    theta: Float[Tensor, " p"],
    problem: TrackingProblem,
    here: LinearisedTracks,
    step: ShootingStep,
    weights: Float[Tensor, "N m s"],
) -> StepTrial:
    """Take a step, and correct the nodes where that is better.

    Args:
        simulator: Model and residuals.
        theta: θ after the step.
        problem: The tracks.
        here: Where the step begins.
        step: The step.
        weights: Of the gaps in the merit function before the step.
    """
    prediction = predict_step(here, step)
    weights = penalty_weights(weights, prediction.multipliers)
    before = merit(here.simulated, weights)
    left = (1 - step.closing)[:, None, None] * here.simulated.gap
    linear = here.simulated._replace(cost=prediction.cost, gap=left)
    predicted = before - merit(linear, weights)
    first = simulator.simulate(theta, problem, prediction.unknowns)
    surplus = first.gap - left
    nodes = prediction.unknowns.nodes + node_corrections(here.jacobian, surplus)
    second = prediction.unknowns._replace(nodes=nodes)
    corrected = simulator.simulate(theta, problem, second)
    better = merit(corrected, weights) < merit(first, weights)
    unknowns = choose_per_track(better, second, prediction.unknowns)
    simulated = choose_per_track(better, corrected, first)
    return StepTrial(unknowns, simulated, weights, predicted, before - merit(simulated, weights))


def choose_per_track(better: Bool[Tensor, " N"], new: Any, old: Any) -> Any:
    """Per track, the new record where it is better, else the old one."""
    pairs = zip(new, old, strict=True)
    return type(new)(
        *(torch.where(better.reshape(-1, *[1] * (n.dim() - 1)), n, o) for n, o in pairs)
    )


def predict_step(here: LinearisedTracks, step: ShootingStep) -> LinearPrediction:
    """Follow a step along the linearisation; θ may have no column there, and none in the step."""
    unknowns, now, jacobian = here
    closing = step.closing.expand(len(step.local)).unsqueeze(-1)
    moved = (jacobian.local @ step.local.unsqueeze(-1)).squeeze(-1)
    change = moved + jacobian.shared @ step.shared + closing * jacobian.offset
    residual = now.residual + change.view_as(now.residual)
    vector = stack_unknowns(unknowns) + step.local
    shared = step.shared.expand(len(step.local), -1)
    columns = torch.cat([shared, step.local, closing], -1)
    nodes = unknowns.nodes + (jacobian.nodes @ columns[:, None, :, None]).squeeze(-1)
    cost = 0.5 * (residual.square().sum((1, 2)) + vector.square().sum(-1))
    return LinearPrediction(
        unstack_unknowns(vector, nodes),
        cost,
        continuity_multipliers(jacobian, residual, nodes.shape[1]),
    )


def penalty_weights(
    before: Float[Tensor, "N m s"], multipliers: Float[Tensor, "N m s"]
) -> Float[Tensor, "N m s"]:
    """Weights that no multiplier exceeds, and that forget earlier ones by halves."""
    size = multipliers.abs()
    return torch.maximum(size, 0.5 * (before + size))


def merit(simulated: TrackSimulation, weights: Float[Tensor, "N m s"]) -> Float[Tensor, " N"]:
    """Cost of each track with the penalty of its gaps."""
    return simulated.cost + (weights * simulated.gap.abs()).sum((1, 2))
