"""The tracking problem as differentiable MPC inside of a fit of the physical parameters.

The inner problem is the one of `problem`, solved by `ILQR` with exact second derivatives: its
first step places the vehicle, the others drive it. The outer problem is the least cost of the
inner one as a function of θ, whose gradient the solver gives exactly by implicit differentiation.
It shares nothing with `Shooting` but the problem, and so checks it.
"""

import logging
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.func import functional_call
from torch.nn.functional import pad

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.control import ILQR, Bounds, Solution
from diffstack_mmv.identification.fit import Data, EarlyStopping, Fit, Watch
from diffstack_mmv.identification.linearisation import Tracker
from diffstack_mmv.identification.problem import (
    INTENTION,
    PLACEMENT,
    Problem,
    Targets,
    TrackedVehicle,
    Unknowns,
)
from diffstack_mmv.identification.tracking import Tracked

logger = logging.getLogger(__name__)

EVALUATIONS = 20  # of the cost per line search, at most


class Inner(torch.nn.Module):
    """Dynamics and cost of the inner problem; the last column of the state says "placed".

    Args:
        vehicle: Model with intention and residuals.
        problem: The tracks.
    """

    def __init__(self, vehicle: TrackedVehicle, problem: Problem) -> None:
        super().__init__()
        self.vehicle = vehicle
        self.start = problem.start
        # before it is placed, a vehicle is compared with nothing
        earlier = Targets(*(torch.cat([part[:, :1], part], 1) for part in problem.targets))
        weight, controls = earlier.weight.clone(), earlier.control_weight.clone()
        weight[:, 0], controls[:, 0] = 0, 0
        self.targets = earlier._replace(weight=weight, control_weight=controls)

    def outset(self) -> Float[Tensor, "N s"]:
        """State before the placement."""
        placed = self.vehicle.place(torch.zeros_like(self.start), self.start)
        return pad(placed, (0, 1))

    def forward(self, first: Tensor, second: Tensor, cost: bool = False) -> Tensor:
        """Cost of each time from states and controls, or the next state from a state and a control.

        A functional call reaches a module by one method only, hence both in one.
        """
        return self._cost(first, second) if cost else self._step(first, second)

    def _step(
        self, state: Float[Tensor, "N s"], control: Float[Tensor, "N 6"]
    ) -> Float[Tensor, "N s"]:
        placed = state[..., -1:] > 0
        driven = self.vehicle.advance(state[..., :-1], control[..., :INTENTION])
        begun = self.vehicle.place(control, self.start)
        return pad(torch.where(placed, driven, begun), (0, 1), value=1.0)

    def _cost(
        self, states: Float[Tensor, "N T1 s"], controls: Float[Tensor, "N T1 6"]
    ) -> Float[Tensor, "N T1"]:
        residual = self.vehicle.residual(states[..., :-1], self.targets)
        return 0.5 * (residual.square().sum(-1) + controls.square().sum(-1))


class Solved(NamedTuple):
    """Solution of the inner problem and what it means."""

    solution: Solution
    unknowns: Unknowns


@dataclass(frozen=True)
class Nested:
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
    stopping: EarlyStopping = EarlyStopping()

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)

    def __call__(
        self, tracker: Tracker, data: Data, before: Fit, active: Bool[Tensor, " p"]
    ) -> Fit:
        """Fit the active entries of θ, beginning at `before`."""
        theta = before.theta.clone().requires_grad_()
        guess = {"fitted": before.fitted.unknowns, "heldout": before.heldout.unknowns}
        watch = Watch(self.stopping, before)
        search = torch.optim.LBFGS(
            [theta], max_iter=1, max_eval=EVALUATIONS, line_search_fn="strong_wolfe"
        )
        last = float("inf")

        def objective() -> Tensor:
            search.zero_grad()
            solved = self.solve(tracker, data.fitted, theta, guess["fitted"])
            guess["fitted"] = detached(solved.unknowns)
            penalty = 0.5 * tracker.parameters.penalty(theta).square().sum()
            cost = solved.solution.cost.sum() + penalty
            cost.backward()
            if theta.grad is not None:
                theta.grad[~active] = 0
            return cost.detach()

        for _ in range(self.max_iterations):
            with torch.enable_grad():
                search.step(objective)
            fit, cost = self._fit(tracker, data, before, theta.detach().clone(), guess)
            if not watch.see(fit, cost) or last - cost < self.tolerance * cost:
                break
            last = cost
        return watch.best._replace(history=tuple(watch.history))

    def solve(
        self, tracker: Tracker, problem: Problem, theta: Float[Tensor, " p"], guess: Unknowns
    ) -> Solved:
        """Solve the inner problem; differentiable in θ where gradients are enabled."""
        inner = Inner(tracker.vehicle, problem)
        offsets = tracker.parameters.tensors(theta, "vehicle.model.")

        def dynamics(state: Tensor, control: Tensor) -> Tensor:
            return functional_call(inner, offsets, (state, control))

        def cost(states: Tensor, controls: Tensor) -> Tensor:
            return functional_call(inner, offsets, (states, controls, True))

        free = guess.placement.new_full((PLACEMENT,), torch.inf)
        rates = pad(guess.rates, (0, PLACEMENT - INTENTION))
        controls = torch.cat([guess.placement.unsqueeze(1), rates], 1)
        solution = self.solver(dynamics, cost, Bounds(-free, free), inner.outset(), controls)
        placement, rates = solution.controls[:, 0], solution.controls[:, 1:, :INTENTION]
        found = Unknowns(placement, rates, guess.nodes)
        return Solved(solution, found)

    def _fit(
        self,
        tracker: Tracker,
        data: Data,
        before: Fit,
        theta: Float[Tensor, " p"],
        guess: dict[str, Unknowns],
    ) -> tuple[Fit, float]:
        """The iterate as a fit, with its cost; the held-out tracks are solved as well."""
        with torch.no_grad():
            parts = {}
            for name, problem in data._asdict().items():
                solved = self.solve(tracker, problem, theta, guess[name])
                driven = tracker.drive(theta, problem, solved.unknowns)
                guess[name] = driven.unknowns
                parts[name] = Tracked(*driven, solved.solution.converged)
            fit = before._replace(theta=theta, **parts)
            penalty = 0.5 * tracker.parameters.penalty(theta).square().sum()
            return fit, float(fit.fitted.simulated.cost.sum() + penalty)


def detached(unknowns: Unknowns) -> Unknowns:
    """The numbers without their graph."""
    return Unknowns(*(part.detach() for part in unknowns))
