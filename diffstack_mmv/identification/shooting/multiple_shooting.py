"""Controls and physical parameters fitted together by multiple shooting."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive, require_switch
from diffstack_mmv.identification.shooting.block_arrowhead import StepBounds, solve_arrowhead
from diffstack_mmv.identification.shooting.fit import (
    NO_STOPPING,
    EstimationData,
    HeldoutMonitor,
    HeldoutStopping,
    ParameterFit,
    in_prior_deviations,
    total_cost,
)
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.merit import (
    LinearisedTracks,
    ShootingStep,
    gap_closure,
    try_step,
)
from diffstack_mmv.identification.shooting.normal_equations import normal_equations
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.tracking import (
    FIRST_DAMPING,
    LEAST_DAMPING,
    MOST_DAMPING,
    LevenbergMarquardt,
    TrackingSolution,
    close_gaps,
    damping_factor,
    infer_controls_with_gaps,
)

PATIENCE = 10  # iterations within which a fit from a poor start comes down
MAX_STEP = 1.0  # prior deviations by which one step may change a value


class EstimationTask(NamedTuple):
    """What all iterations of a fit share."""

    simulator: TrackSimulator
    data: EstimationData
    active: Bool[Tensor, " p"]  # which entries of θ are fitted


class EvaluatedStep(NamedTuple):
    """A fit after a step, with the decrease that the step had and that it predicted."""

    fit: ParameterFit
    weights: Float[Tensor, "N m s"]  # of the gaps in the merit function
    decrease: float  # of the merit function
    predicted_decrease: float


class ShootingIterate(NamedTuple):
    """State of the iteration of a fit."""

    fit: ParameterFit
    weights: Float[Tensor, "N m s"]
    damping: float
    improved: bool = True  # whether the last iteration lowered the merit
    finished: bool = False


@dataclass(frozen=True)
class MultipleShooting:
    """Multiple shooting: controls, initial conditions, nodes and θ at once, by Levenberg-Marquardt.

    Per step the nodes are eliminated by continuity and each track by its Schur complement. The
    length of the shooting intervals is `TrackingSettings.segment_steps`.

    Args:
        max_iterations: Limit of iterations.
        tolerance: Predicted relative decrease of the cost at which the fit has converged.
        stopping: When to stop early.
        heldout_iterations: Iterations per step for the controls of the held-out tracks.
        restart: Whether the fitted tracks begin at their nodes as recorded, which rarely ends in a
            poor optimum, rather than at the last solution. A fit that ends above the cost of that
            solution is repeated from there.
        give_up_above: Cost above which a fit is given up after `PATIENCE` iterations, and not
            repeated.

    Raises:
        ValueError: A limit is below one, or the tolerance is not positive.
    """

    max_iterations: int = 40
    tolerance: float = 1e-6
    stopping: HeldoutStopping = HeldoutStopping()
    heldout_iterations: int = 1
    restart: bool = True
    give_up_above: float = torch.inf

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)
        require_at_least("heldout_iterations", self.heldout_iterations, 1)
        require_positive("tolerance", self.tolerance)
        require_switch("restart", self.restart)

    def unstopped(self) -> "MultipleShooting":
        """The same algorithm, which no held-out track ends."""
        return replace(self, stopping=NO_STOPPING)

    def searching(self, cost: float) -> "MultipleShooting":
        """The same algorithm for one start of many, given up where it stays above a cost."""
        return replace(self, give_up_above=cost)

    def __call__(
        self,
        simulator: TrackSimulator,
        data: EstimationData,
        before: ParameterFit,
        active: Bool[Tensor, " p"],
    ) -> ParameterFit:
        """Fit the active entries of θ, beginning at `before`."""
        task = EstimationTask(simulator, data, active)
        if not self.restart:
            return self._run(task, before, before)
        guess = data.fitted.guess
        simulated = simulator.simulate(before.theta, data.fitted, guess)
        recorded = TrackingSolution(guess, simulated, before.fitted.converged)
        fit = self._run(task, before, before._replace(fitted=recorded))
        once = self.give_up_above < torch.inf
        if once or total_cost(simulator, fit) <= total_cost(simulator, before):
            return fit
        return self._run(task, before, before)

    def _run(self, task: EstimationTask, before: ParameterFit, start: ParameterFit) -> ParameterFit:
        """Iterate from `start`; `before` is what held-out tracks are compared with."""
        simulator, data, _ = task
        monitor = HeldoutMonitor(self.stopping, before)
        monitor.observe(before, total_cost(simulator, before))
        now = ShootingIterate(start, torch.zeros_like(start.fitted.simulated.gap), FIRST_DAMPING)
        for iteration in range(self.max_iterations):
            if iteration >= PATIENCE and not total_cost(simulator, now.fit) <= self.give_up_above:
                break
            now = self._next(task, now)
            if now.improved:
                now = now._replace(fit=self._with_heldout(simulator, data, now.fit))
                if not monitor.observe(now.fit, total_cost(simulator, now.fit)):
                    break
            if now.finished:
                break
        best = monitor.best
        return best._replace(
            fitted=close_gaps(simulator, best.theta, data.fitted, best.fitted),
            heldout=close_gaps(simulator, best.theta, data.heldout, best.heldout),
            history=tuple(monitor.history),
        )

    def _next(self, task: EstimationTask, now: ShootingIterate) -> ShootingIterate:
        """Linearise, and damp the step until it lowers the merit."""
        fit, weights, damping = now.fit, now.weights, now.damping
        unknowns, simulated, _ = fit.fitted
        jacobian = task.simulator.jacobian(fit.theta, task.data.fitted, unknowns, simulated)
        here = LinearisedTracks(unknowns, simulated, jacobian)
        least = self.tolerance * total_cost(task.simulator, fit)
        while damping <= MOST_DAMPING:
            step = _evaluate_step(task, fit, here, weights, damping)
            weights, small = step.weights, step.predicted_decrease < least
            # as a tensor: tracks that are followed exactly leave nothing to divide by
            ratio = torch.tensor(step.decrease) / step.predicted_decrease
            damping = max(damping * float(damping_factor(ratio)), LEAST_DAMPING)
            if step.decrease > 0:
                return ShootingIterate(step.fit, weights, damping, finished=small)
            if small:
                break
        return ShootingIterate(fit, weights, damping, improved=False, finished=True)

    def _with_heldout(
        self, simulator: TrackSimulator, data: EstimationData, fit: ParameterFit
    ) -> ParameterFit:
        few = LevenbergMarquardt(self.heldout_iterations)
        heldout = infer_controls_with_gaps(
            simulator, fit.theta, data.heldout, fit.heldout.unknowns, few
        )
        return fit._replace(heldout=heldout)


def _evaluate_step(
    task: EstimationTask,
    fit: ParameterFit,
    here: LinearisedTracks,
    weights: Float[Tensor, "N m s"],
    damping: float,
) -> EvaluatedStep:
    """Solve the damped equations, take the step and evaluate it."""
    simulator, data, active = task
    unknowns, simulated, jacobian = here
    parameters = simulator.parameters
    share = simulated.cost.new_tensor([damping])
    closing = gap_closure(share)
    plain = normal_equations(jacobian, simulated.residual, unknowns, closing)
    system = in_prior_deviations(plain, simulator, fit.theta).restricted(active)
    box = _step_box(parameters, fit.theta, active)
    local, shared = solve_arrowhead(system.damped(share.expand(len(unknowns.rates)), share[0]), box)
    deviations = torch.zeros_like(fit.theta)
    deviations[active] = shared
    change = parameters.prior.std * deviations
    theta = torch.where(active, parameters.moved(fit.theta, deviations), fit.theta)
    step = ShootingStep(local, change / parameters.slope(fit.theta), closing)
    trial = try_step(simulator, theta, data.fitted, here, step, weights)
    prior = parameters.penalty(fit.theta)
    predicted_decrease = prior.square() - (prior + deviations).square()
    decrease = prior.square() - parameters.penalty(theta).square()
    fitted = fit.fitted._replace(unknowns=trial.unknowns, simulated=trial.simulated)
    return EvaluatedStep(
        fit._replace(theta=theta, fitted=fitted),
        trial.weights,
        float(trial.decrease.sum() + 0.5 * decrease.sum()),
        float(trial.predicted_decrease.sum() + 0.5 * predicted_decrease.sum()),
    )


def _step_box(
    parameters: ParameterVector, theta: Float[Tensor, " p"], active: Bool[Tensor, " p"]
) -> StepBounds:
    """Bounds of a step of the active values: their ranges, and the longest step."""
    lower, upper = parameters.bounds_of_moves(theta)
    return StepBounds(lower[active].clamp_min(-MAX_STEP), upper[active].clamp_max(MAX_STEP))
