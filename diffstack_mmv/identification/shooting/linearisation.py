"""Residuals of tracks and their Jacobians.

All shooting intervals of all tracks are simulated in one batch; then all their steps are linearised
in one batched call of forward-mode derivatives, which `condensing` chains to those of whole tracks.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import functional_call, jvp, vmap
from torch.nn.functional import pad

from diffstack_mmv.identification.shooting.condensing import (
    CondensedJacobian,
    StepJacobian,
    condense,
)
from diffstack_mmv.identification.shooting.intervals import (
    join_intervals,
    node_times,
    split_intervals,
)
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.problem import (
    COMMAND_DIM,
    INITIAL_DIM,
    Measurements,
    TrackingProblem,
    Unknowns,
)
from diffstack_mmv.identification.shooting.tracking_model import TrackingModel


class TrackSimulation(NamedTuple):
    """States and residuals of tracks under some unknowns."""

    states: Float[Tensor, "N T1 s"]
    residual: Float[Tensor, "N T1 k"]
    cost: Float[Tensor, " N"]  # ½ of all squares of a track, regularisation included
    gap: Float[Tensor, "N m s"]  # end of an interval minus the node after it; zero in the padding


class SimulatedTracks(NamedTuple):
    """Tracks without gaps, with unknowns whose nodes lie on them."""

    unknowns: Unknowns
    simulated: TrackSimulation


class TrackSimulator:
    """Simulates and linearises a tracking problem as a function of its unknowns and of θ.

    Args:
        vehicle: Model with the rider's command in its state, and residuals.
        parameters: The learned numbers θ.
    """

    def __init__(self, vehicle: TrackingModel, parameters: ParameterVector) -> None:
        self.vehicle = vehicle
        self.parameters = parameters

    def _stage(
        self, theta: Tensor, state: Tensor, rates: Tensor, measured: Measurements
    ) -> tuple[Tensor, Tensor]:
        offsets = self.parameters.tensors(theta, "model.")
        return functional_call(self.vehicle, offsets, (state, rates, measured))

    def _initial_state(self, theta: Tensor, initial: Tensor, start: Tensor) -> Tensor:
        offsets = self.parameters.tensors(theta, "vehicle.model.")
        return functional_call(_InitialState(self.vehicle), offsets, (initial, start))

    def simulate(
        self, theta: Float[Tensor, " p"], problem: TrackingProblem, unknowns: Unknowns
    ) -> TrackSimulation:
        """States, residuals, cost and gaps of each track, all intervals in one batch."""
        stages, nodes = unknowns.rates.shape[1] + 1, unknowns.nodes.shape[1]
        rates = split_intervals(pad(unknowns.rates, (0, 0, 0, 1)), nodes + 1)
        measurements = Measurements(
            *(split_intervals(part, nodes + 1) for part in problem.measurements)
        )
        first = self._initial_state(theta, unknowns.initial, problem.start)
        state = torch.cat([first.unsqueeze(1), unknowns.nodes], 1)
        states, residuals = [], []
        for step in range(rates.shape[2]):
            measured = Measurements(*(part[:, :, step] for part in measurements))
            states.append(state)
            state, residual = self._stage(theta, state, rates[:, :, step], measured)
            residuals.append(residual)
        residual = join_intervals(torch.stack(residuals, 2), stages)
        squares = residual.square().sum((1, 2)) + unknowns.rates.square().sum((1, 2))
        cost = 0.5 * (squares + unknowns.initial.square().sum(-1))
        gap = (state[:, :-1] - unknowns.nodes) * node_mask(problem, nodes).unsqueeze(-1)
        return TrackSimulation(join_intervals(torch.stack(states, 2), stages), residual, cost, gap)

    def simulate_continuous(
        self, theta: Float[Tensor, " p"], problem: TrackingProblem, unknowns: Unknowns
    ) -> SimulatedTracks:
        """Simulate each track as one interval, and put the nodes on it: no gap is left."""
        alone = unknowns._replace(nodes=unknowns.nodes[:, :0])
        simulated = self.simulate(theta, problem, alone)
        stages, nodes = simulated.states.shape[1], unknowns.nodes.shape[1]
        at_nodes = simulated.states[:, node_times(stages, nodes)]
        whole = simulated._replace(gap=torch.zeros_like(at_nodes))
        return SimulatedTracks(unknowns._replace(nodes=at_nodes), whole)

    def step_jacobian(
        self,
        theta: Tensor,
        problem: TrackingProblem,
        unknowns: Unknowns,
        states: Tensor,
        shared: bool,
    ) -> StepJacobian:
        """Linearise all steps of all tracks in one call, one tangent per column.

        Args:
            theta: θ, of shape (p,).
            problem: The N tracks.
            unknowns: Where to linearise.
            states: States under them, of shape (N, T1, s).
            shared: Whether θ is differentiated as well.
        """
        padded = pad(unknowns.rates, (0, 0, 0, 1))
        widths = [len(theta) if shared else 0, states.shape[-1], COMMAND_DIM]
        of_theta, of_state, of_rates = _seeds(theta, widths)

        def stage(theta: Tensor, state: Tensor, rates: Tensor) -> tuple[Tensor, Tensor]:
            return self._stage(theta, state, rates, problem.measurements)

        def column(of_theta: Tensor, of_state: Tensor, of_rates: Tensor) -> tuple[Tensor, Tensor]:
            tangents = (of_theta, of_state.expand_as(states), of_rates.expand_as(padded))
            following, residual = jvp(stage, (theta, states, padded), tangents)[1]
            return following, residual

        following, residual = vmap(column)(of_theta, of_state, of_rates)
        by_theta, by_state, by_rates = following.movedim(0, -1).split(widths, -1)
        r_theta, r_state, _ = residual.movedim(0, -1).split(widths, -1)
        return StepJacobian(by_state, by_rates, by_theta, r_state, r_theta)

    def _initial_jacobian(
        self, theta: Tensor, problem: TrackingProblem, unknowns: Unknowns, shared: bool
    ) -> Tensor:
        """Derivatives of the first state by θ and the initial condition."""
        of_theta, of_initial = _seeds(theta, [len(theta) if shared else 0, INITIAL_DIM])

        def initial_state(theta: Tensor, initial: Tensor) -> Tensor:
            return self._initial_state(theta, initial, problem.start)

        def column(of_theta: Tensor, of_initial: Tensor) -> Tensor:
            tangents = (of_theta, of_initial.expand_as(unknowns.initial))
            return jvp(initial_state, (theta, unknowns.initial), tangents)[1]

        return vmap(column)(of_theta, of_initial).movedim(0, -1)

    def jacobian(
        self,
        theta: Tensor,
        problem: TrackingProblem,
        unknowns: Unknowns,
        simulated: TrackSimulation,
        shared: bool = True,
    ) -> CondensedJacobian:
        """Derivatives of the residuals of whole tracks (without the unit rows of c and d).

        Args:
            theta: θ, of shape (p,).
            problem: The tracks.
            unknowns: Where to linearise.
            simulated: States under them.
            shared: Whether θ is differentiated as well.
        """
        steps = self.step_jacobian(theta, problem, unknowns, simulated.states, shared)
        first = self._initial_jacobian(theta, problem, unknowns, shared)
        return condense(steps, first, simulated.gap, node_mask(problem, unknowns.nodes.shape[1]))


def _seeds(theta: Tensor, widths: list[int]) -> list[Tensor]:
    """Unit tangents by their kind; without columns for θ its tangents are zero."""
    eye = torch.eye(sum(widths), dtype=theta.dtype)
    first, *rest = eye.split(widths, 1)
    if widths[0] < len(theta):
        first = eye.new_zeros(len(eye), len(theta))
    return [first, *rest]


class _InitialState(torch.nn.Module):
    """The initial state as a forward call, which functional calls need."""

    def __init__(self, vehicle: TrackingModel) -> None:
        super().__init__()
        self.vehicle = vehicle

    def forward(self, initial: Tensor, start: Tensor) -> Tensor:
        return self.vehicle.initial_state(initial, start)


def node_mask(problem: TrackingProblem, nodes: int) -> Float[Tensor, "N m"]:
    """One for nodes on a track, zero for those in the padding behind its end."""
    weight = problem.measurements.weight
    return (weight[:, node_times(weight.shape[1], nodes)] > 0).to(weight)
