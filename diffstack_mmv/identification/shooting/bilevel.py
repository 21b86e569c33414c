"""Bilevel fit: the tracking problem as differentiable MPC inside of a fit of the parameters.

The inner problem is that of `problem`, solved by `ILQR` with exact second derivatives: its first
step sets the initial condition, the others drive the vehicle. The outer problem is the least cost
of the inner one as a function of θ, whose gradient the solver gives exactly by implicit
differentiation. It shares only the problem with `MultipleShooting`, and so checks it.
"""

import logging
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn.functional import pad

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.control import ILQR, Batched, Bounds, Solution
from diffstack_mmv.identification.shooting.fit import (
    NO_STOPPING,
    EstimationData,
    HeldoutMonitor,
    HeldoutStopping,
    ParameterFit,
)
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.problem import (
    COMMAND_DIM,
    INITIAL_DIM,
    Measurements,
    TrackingProblem,
    Unknowns,
)
from diffstack_mmv.identification.shooting.tracking import TrackingSolution
from diffstack_mmv.identification.shooting.tracking_model import TrackingModel

logger = logging.getLogger(__name__)

MAX_EVALUATIONS = 20  # of the cost per line search, at most


class InnerDynamics(nn.Module):
    """Steps of the inner problem: the first sets the initial condition, the others drive.

    The last column of the state is zero before the first step and one after it.

    Args:
        vehicle: Model with the rider's command in its state.
    """

    def __init__(self, vehicle: TrackingModel) -> None:
        super().__init__()
        self.vehicle = vehicle

    def forward(
        self,
        state: Float[Tensor, "N s"],
        control: Float[Tensor, "N 6"],
        start: Float[Tensor, "N 6"],
    ) -> Float[Tensor, "N s"]:
        """State after one step."""
        driven = self.vehicle.step(state[..., :-1], control[..., :COMMAND_DIM])
        first = self.vehicle.initial_state(control, start)
        return pad(torch.where(state[..., -1:] > 0, driven, first), (0, 1), value=1.0)

    def before_first(self, start: Float[Tensor, "N 6"]) -> Float[Tensor, "N s"]:
        """State before the first step."""
        return pad(self.vehicle.initial_state(torch.zeros_like(start), start), (0, 1))


class InnerCost(nn.Module):
    """Cost of each time of the inner problem.

    Args:
        vehicle: Model with the residuals.
    """

    def __init__(self, vehicle: TrackingModel) -> None:
        super().__init__()
        self.vehicle = vehicle

    def forward(
        self,
        states: Float[Tensor, "N T1 s"],
        controls: Float[Tensor, "N T1 6"],
        *measured: Float[Tensor, "N T1 ..."],
    ) -> Float[Tensor, "N T1"]:
        """Half of the squares of residuals and unknowns, given the columns of `Measurements`."""
        residual = self.vehicle.residual(states[..., :-1], Measurements(*measured))
        return 0.5 * (residual.square().sum(-1) + controls.square().sum(-1))


def with_unmeasured_start(measurements: Measurements) -> Measurements:
    """Measurements with a time before the first step, which weighs nothing."""
    earlier = Measurements(*(torch.cat([part[:, :1], part], 1) for part in measurements))
    weight, controls = earlier.weight.clone(), earlier.control_weight.clone()
    weight[:, 0], controls[:, 0] = 0, 0
    return earlier._replace(weight=weight, control_weight=controls)


class InnerSolution(NamedTuple):
    """Solution of the inner problem, and the unknowns of the tracks in it."""

    solution: Solution
    unknowns: Unknowns


@dataclass(frozen=True)
class BilevelFit:
    """L-BFGS on θ around differentiable MPC, with its exact implicit gradient.

    Args:
        max_iterations: Limit of outer iterations.
        tolerance: Relative decrease of the cost below which the fit has converged.
        solver: Of the inner problem.
        stopping: When to stop early.

    Raises:
        ValueError: The limit is below one.
    """

    max_iterations: int = 20
    tolerance: float = 1e-6
    solver: ILQR = ILQR(max_iterations=40, tolerance=1e-9)
    stopping: HeldoutStopping = HeldoutStopping()

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)

    def unstopped(self) -> "BilevelFit":
        """The same algorithm, which no held-out track ends."""
        return replace(self, stopping=NO_STOPPING)

    def __call__(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        before: ParameterFit,
        active: Bool[Tensor, " p"],
    ) -> ParameterFit:
        """Fit the active entries of θ, beginning at `before`."""
        theta = before.theta.clone().requires_grad_()
        guess = {"fitted": before.fitted.unknowns, "heldout": before.heldout.unknowns}
        monitor = HeldoutMonitor(self.stopping, before)
        search = torch.optim.LBFGS(
            [theta], max_iter=1, max_eval=MAX_EVALUATIONS, line_search_fn="strong_wolfe"
        )
        last = float("inf")

        def objective() -> Tensor:
            search.zero_grad()
            solved = self.solve(simulator, data.fitted, theta, guess["fitted"])
            guess["fitted"] = detached(solved.unknowns)
            penalty = 0.5 * simulator.parameters.penalty(theta).square().sum()
            cost = solved.solution.cost.sum() + penalty
            cost.backward()
            if theta.grad is not None:
                theta.grad[~active] = 0
            return cost.detach()

        for _ in range(self.max_iterations):
            with torch.enable_grad():
                search.step(objective)
            fit, cost = self._fit(simulator, data, before, theta.detach().clone(), guess)
            if not monitor.observe(fit, cost) or last - cost < self.tolerance * cost:
                break
            last = cost
        return monitor.best._replace(history=tuple(monitor.history))

    def solve(
        self,
        simulator: TrackSimulator,
        problem: TrackingProblem,
        theta: Float[Tensor, " p"],
        guess: Unknowns,
    ) -> InnerSolution:
        """Solve the inner problem; differentiable in θ where gradients are enabled."""
        offsets = simulator.parameters.tensors(theta, "vehicle.model.")
        inner, price = InnerDynamics(simulator.vehicle), InnerCost(simulator.vehicle)

        def step(*arguments: Tensor) -> Tensor:
            return functional_call(inner, offsets, arguments)

        def cost(*arguments: Tensor) -> Tensor:
            return functional_call(price, offsets, arguments)

        free = guess.initial.new_full((INITIAL_DIM,), torch.inf)
        rates = pad(guess.rates, (0, INITIAL_DIM - COMMAND_DIM))
        solution = self.solver(
            Batched(step, problem.start),
            Batched(cost, *with_unmeasured_start(problem.measurements)),
            Bounds(-free, free),
            inner.before_first(problem.start),
            torch.cat([guess.initial.unsqueeze(1), rates], 1),
        )
        initial, rates = solution.controls[:, 0], solution.controls[:, 1:, :COMMAND_DIM]
        return InnerSolution(solution, Unknowns(initial, rates, guess.nodes))

    def _fit(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        before: ParameterFit,
        theta: Float[Tensor, " p"],
        guess: dict[str, Unknowns],
    ) -> tuple[ParameterFit, float]:
        """The iterate as a fit, with its cost; the held-out tracks are solved as well."""
        with torch.no_grad():
            parts = {}
            for name, problem in data._asdict().items():
                solved = self.solve(simulator, problem, theta, guess[name])
                continuous = simulator.simulate_continuous(theta, problem, solved.unknowns)
                guess[name] = continuous.unknowns
                parts[name] = TrackingSolution(*continuous, solved.solution.converged)
            fit = before._replace(theta=theta, **parts)
            penalty = 0.5 * simulator.parameters.penalty(theta).square().sum()
            return fit, float(fit.fitted.simulated.cost.sum() + penalty)


def detached(unknowns: Unknowns) -> Unknowns:
    """The unknowns without their graph."""
    return Unknowns(*(part.detach() for part in unknowns))
