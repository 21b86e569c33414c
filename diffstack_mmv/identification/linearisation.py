"""Residuals of tracks and their Jacobians.

All segments of all tracks are simulated side by side; then all their steps are linearised in one
batched call of forward-mode derivatives, which `condensing` chains to those of whole tracks.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import functional_call, jvp, vmap
from torch.nn.functional import pad

from diffstack_mmv.identification.arrow import Arrow
from diffstack_mmv.identification.condensing import Jacobian, StepJacobian, condensed
from diffstack_mmv.identification.parameters import LearnedParameters
from diffstack_mmv.identification.problem import (
    INTENTION,
    PLACEMENT,
    Problem,
    Targets,
    TrackedVehicle,
    Unknowns,
)
from diffstack_mmv.identification.segments import connected, node_times, segmented


class Simulated(NamedTuple):
    """States and residuals of tracks under some unknowns."""

    states: Float[Tensor, "N T1 s"]
    residual: Float[Tensor, "N T1 k"]
    cost: Float[Tensor, " N"]  # ½ of all squares of a track, regularisation included
    gap: Float[Tensor, "N m s"]  # end of a segment minus the node after it; zero in the padding


class Driven(NamedTuple):
    """Tracks in one piece, with unknowns whose nodes lie on them."""

    unknowns: Unknowns
    simulated: Simulated


class Tracker:
    """Simulates and linearises a tracking problem as a function of its unknowns and of θ.

    Args:
        vehicle: Model with intention and residuals.
        parameters: The learned numbers θ.
    """

    def __init__(self, vehicle: TrackedVehicle, parameters: LearnedParameters) -> None:
        self.vehicle = vehicle
        self.parameters = parameters

    def _stage(
        self, theta: Tensor, state: Tensor, rates: Tensor, target: Targets
    ) -> tuple[Tensor, Tensor]:
        offsets = self.parameters.tensors(theta, "model.")
        return functional_call(self.vehicle, offsets, (state, rates, target))

    def _place(self, theta: Tensor, placement: Tensor, start: Tensor) -> Tensor:
        offsets = self.parameters.tensors(theta, "vehicle.model.")
        return functional_call(_Placement(self.vehicle), offsets, (placement, start))

    def simulate(
        self, theta: Float[Tensor, " p"], problem: Problem, unknowns: Unknowns
    ) -> Simulated:
        """States, residuals, cost and gaps of each track, all segments side by side."""
        stages, nodes = unknowns.rates.shape[1] + 1, unknowns.nodes.shape[1]
        rates = segmented(pad(unknowns.rates, (0, 0, 0, 1)), nodes + 1)
        targets = Targets(*(segmented(part, nodes + 1) for part in problem.targets))
        begun = self._place(theta, unknowns.placement, problem.start)
        state = torch.cat([begun.unsqueeze(1), unknowns.nodes], 1)
        states, residuals = [], []
        for step in range(rates.shape[2]):
            target = Targets(*(part[:, :, step] for part in targets))
            states.append(state)
            state, residual = self._stage(theta, state, rates[:, :, step], target)
            residuals.append(residual)
        residual = connected(torch.stack(residuals, 2), stages)
        squares = residual.square().sum((1, 2)) + unknowns.rates.square().sum((1, 2))
        cost = 0.5 * (squares + unknowns.placement.square().sum(-1))
        gap = (state[:, :-1] - unknowns.nodes) * live(problem, nodes).unsqueeze(-1)
        return Simulated(connected(torch.stack(states, 2), stages), residual, cost, gap)

    def drive(self, theta: Float[Tensor, " p"], problem: Problem, unknowns: Unknowns) -> Driven:
        """Go through each track in one piece, and put the nodes on the way: no gap is left."""
        alone = unknowns._replace(nodes=unknowns.nodes[:, :0])
        simulated = self.simulate(theta, problem, alone)
        stages, nodes = simulated.states.shape[1], unknowns.nodes.shape[1]
        met = simulated.states[:, node_times(stages, nodes)]
        whole = simulated._replace(gap=torch.zeros_like(met))
        return Driven(unknowns._replace(nodes=met), whole)

    def step_jacobian(
        self, theta: Tensor, problem: Problem, unknowns: Unknowns, states: Tensor, shared: bool
    ) -> StepJacobian:
        """Linearise all steps of all tracks in one call, one tangent per column."""
        padded = pad(unknowns.rates, (0, 0, 0, 1))
        widths = [len(theta) if shared else 0, states.shape[-1], INTENTION]
        of_theta, of_state, of_rates = _seeds(theta, widths)

        def stage(theta: Tensor, state: Tensor, rates: Tensor) -> tuple[Tensor, Tensor]:
            return self._stage(theta, state, rates, problem.targets)

        def column(of_theta: Tensor, of_state: Tensor, of_rates: Tensor) -> tuple[Tensor, Tensor]:
            tangents = (of_theta, of_state.expand_as(states), of_rates.expand_as(padded))
            following, residual = jvp(stage, (theta, states, padded), tangents)[1]
            return following, residual

        following, residual = vmap(column)(of_theta, of_state, of_rates)
        by_theta, by_state, by_rates = following.movedim(0, -1).split(widths, -1)
        r_theta, r_state, _ = residual.movedim(0, -1).split(widths, -1)
        return StepJacobian(by_state, by_rates, by_theta, r_state, r_theta)

    def _placement_jacobian(
        self, theta: Tensor, problem: Problem, unknowns: Unknowns, shared: bool
    ) -> Tensor:
        """Derivatives of the first state by θ and the placement."""
        of_theta, of_placement = _seeds(theta, [len(theta) if shared else 0, PLACEMENT])

        def place(theta: Tensor, placement: Tensor) -> Tensor:
            return self._place(theta, placement, problem.start)

        def column(of_theta: Tensor, of_placement: Tensor) -> Tensor:
            tangents = (of_theta, of_placement.expand_as(unknowns.placement))
            return jvp(place, (theta, unknowns.placement), tangents)[1]

        return vmap(column)(of_theta, of_placement).movedim(0, -1)

    def jacobian(
        self,
        theta: Tensor,
        problem: Problem,
        unknowns: Unknowns,
        simulated: Simulated,
        shared: bool = True,
    ) -> Jacobian:
        """Derivatives of the residuals of whole tracks (without the unit rows of c and d).

        Args:
            theta: θ.
            problem: The tracks.
            unknowns: Where to linearise.
            simulated: States under them.
            shared: Whether θ is differentiated as well.
        """
        steps = self.step_jacobian(theta, problem, unknowns, simulated.states, shared)
        begun = self._placement_jacobian(theta, problem, unknowns, shared)
        return condensed(steps, begun, simulated.gap, live(problem, unknowns.nodes.shape[1]))


def _seeds(theta: Tensor, widths: list[int]) -> list[Tensor]:
    """Unit tangents by their kind; without columns for θ its tangents are zero."""
    eye = torch.eye(sum(widths), dtype=theta.dtype)
    first, *rest = eye.split(widths, 1)
    if widths[0] < len(theta):
        first = eye.new_zeros(len(eye), len(theta))
    return [first, *rest]


class _Placement(torch.nn.Module):
    """The placement as a forward call, which functional calls need."""

    def __init__(self, vehicle: TrackedVehicle) -> None:
        super().__init__()
        self.vehicle = vehicle

    def forward(self, placement: Tensor, start: Tensor) -> Tensor:
        return self.vehicle.place(placement, start)


def live(problem: Problem, nodes: int) -> Float[Tensor, "N m"]:
    """One for nodes on a track, zero for those in the padding behind its end."""
    weight = problem.targets.weight
    return (weight[:, node_times(weight.shape[1], nodes)] > 0).to(weight)


def flat(unknowns: Unknowns) -> Float[Tensor, "N z"]:
    """One row per track: placement, then the rates in the order of time."""
    return torch.cat([unknowns.placement, unknowns.rates.flatten(1)], -1)


def unflat(vector: Float[Tensor, "N z"], nodes: Float[Tensor, "N m s"]) -> Unknowns:
    """Undo `flat`, with these nodes."""
    placement, rates = vector[:, :PLACEMENT], vector[:, PLACEMENT:]
    return Unknowns(placement, rates.unflatten(-1, (-1, INTENTION)), nodes)


def normal_equations(
    jacobian: Jacobian,
    residual: Float[Tensor, "N T1 k"],
    unknowns: Unknowns,
    closing: Float[Tensor, "#N"] | None = None,
) -> Arrow:
    """Gauss-Newton equations of ½ |r|² + ½ |c|² + ½ |d|²; the prior of θ is not part of them.

    Args:
        jacobian: Of the residuals.
        residual: Residuals of the segments as they are.
        unknowns: Where it was linearised.
        closing: Share of the gaps that the step closes; all by default.
    """
    own, shared = jacobian.own, jacobian.shared
    share = residual.new_ones(1) if closing is None else closing
    rows = (residual.flatten(1) + share.unsqueeze(-1) * jacobian.offset).unsqueeze(-1)
    identity = torch.eye(own.shape[-1], dtype=own.dtype)
    return Arrow(
        own=own.mT @ own + identity,
        cross=own.mT @ shared,
        shared=(shared.mT @ shared).sum(0),
        own_gradient=(own.mT @ rows).squeeze(-1) + flat(unknowns),
        shared_gradient=(shared.mT @ rows).sum((0, 2)),
    )
