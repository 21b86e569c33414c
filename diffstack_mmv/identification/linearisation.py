"""Residuals of whole tracks and their Jacobians, condensed from those of single steps.

The states are simulated once; then all steps of all tracks are linearised in one batched call of
forward-mode derivatives, and the chain rule is accumulated over time.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import functional_call, jvp, vmap
from torch.nn.functional import pad

from diffstack_mmv.identification.arrow import Arrow
from diffstack_mmv.identification.parameters import LearnedParameters
from diffstack_mmv.identification.problem import (
    INTENTION,
    PLACEMENT,
    Problem,
    Targets,
    TrackedVehicle,
    Unknowns,
)


class Simulated(NamedTuple):
    """States and residuals of tracks under some unknowns."""

    states: Float[Tensor, "N T1 s"]
    residual: Float[Tensor, "N T1 k"]
    cost: Float[Tensor, " N"]  # ½ of all squares of a track, regularisation included


class Jacobian(NamedTuple):
    """Derivatives of the residuals of each track by its unknowns and by θ."""

    own: Float[Tensor, "N r z"]
    shared: Float[Tensor, "N r p"]


class StepJacobian(NamedTuple):
    """Derivatives of single steps."""

    state: Float[Tensor, "N T1 s s"]
    rates: Float[Tensor, "N T1 s 2"]
    shared: Float[Tensor, "N T1 s p"]
    residual_state: Float[Tensor, "N T1 k s"]
    residual_shared: Float[Tensor, "N T1 k p"]


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
        """States, residuals and cost of each track."""
        padded = pad(unknowns.rates, (0, 0, 0, 1))
        state = self._place(theta, unknowns.placement, problem.start)
        states, residuals = [], []
        for time in range(padded.shape[1]):
            target = at_time(problem.targets, time)
            states.append(state)
            state, residual = self._stage(theta, state, padded[:, time], target)
            residuals.append(residual)
        residual = torch.stack(residuals, 1)
        squares = residual.square().sum((1, 2)) + unknowns.rates.square().sum((1, 2))
        cost = 0.5 * (squares + unknowns.placement.square().sum(-1))
        return Simulated(torch.stack(states, 1), residual, cost)

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
        tracks, times, size = simulated.states.shape
        horizon, count = times - 1, steps.shared.shape[-1]
        free = simulated.states.new_zeros(tracks, size, INTENTION * horizon)
        sensitivity = torch.cat([begun, free], -1)
        rows = []
        for time in range(times):
            row = steps.residual_state[:, time] @ sensitivity
            row[..., :count] += steps.residual_shared[:, time]
            rows.append(row)
            if time < horizon:
                sensitivity = steps.state[:, time] @ sensitivity
                sensitivity[..., :count] += steps.shared[:, time]
                first = count + PLACEMENT + INTENTION * time
                sensitivity[..., first : first + INTENTION] += steps.rates[:, time]
        whole = torch.cat(rows, 1)
        return Jacobian(whole[..., count:], whole[..., :count])


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


def at_time(targets: Targets, time: int) -> Targets:
    """The targets of one time."""
    return Targets(*(part[:, time] for part in targets))


def flat(unknowns: Unknowns) -> Float[Tensor, "N z"]:
    """One row per track: placement, then the rates in the order of time."""
    return torch.cat([unknowns.placement, unknowns.rates.flatten(1)], -1)


def unflat(vector: Float[Tensor, "N z"]) -> Unknowns:
    """Undo `flat`."""
    placement, rates = vector[:, :PLACEMENT], vector[:, PLACEMENT:]
    return Unknowns(placement, rates.unflatten(-1, (-1, INTENTION)))


def normal_equations(
    jacobian: Jacobian, residual: Float[Tensor, "N T1 k"], unknowns: Unknowns
) -> Arrow:
    """Gauss-Newton equations of ½ |r|² + ½ |c|² + ½ |d|²; the prior of θ is not part of them."""
    own, shared = jacobian
    rows = residual.flatten(1).unsqueeze(-1)
    identity = torch.eye(own.shape[-1], dtype=own.dtype)
    return Arrow(
        own=own.mT @ own + identity,
        cross=own.mT @ shared,
        shared=(shared.mT @ shared).sum(0),
        own_gradient=(own.mT @ rows).squeeze(-1) + flat(unknowns),
        shared_gradient=(shared.mT @ rows).sum((0, 2)),
    )
