"""Controls that explain recorded tracks, for a vehicle that is known."""

import logging
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least, require_positive
from diffstack_mmv.identification.shooting.block_arrowhead import solve_arrowhead
from diffstack_mmv.identification.shooting.linearisation import TrackSimulation, TrackSimulator
from diffstack_mmv.identification.shooting.merit import (
    LinearisedTracks,
    ShootingStep,
    choose_per_track,
    gap_closure,
    try_step,
)
from diffstack_mmv.identification.shooting.normal_equations import normal_equations
from diffstack_mmv.identification.shooting.problem import Measurements, TrackingProblem, Unknowns

logger = logging.getLogger(__name__)

FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-9
MOST_DAMPING = 1e9
GOOD_RATIO, POOR_RATIO = 0.75, 0.2  # of the decrease to the predicted one


class TrackingSolution(NamedTuple):
    """Unknowns inferred from tracks, and the simulation under them."""

    unknowns: Unknowns
    simulated: TrackSimulation
    converged: Bool[Tensor, " N"]


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Settings of the least-squares solver.

    Args:
        max_iterations: Limit of iterations.
        tolerance: Predicted relative decrease of the cost at which a track has converged.

    Raises:
        ValueError: A number is not positive.
    """

    max_iterations: int = 30
    tolerance: float = 1e-5

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)
        require_positive("tolerance", self.tolerance)


def infer_controls(
    simulator: TrackSimulator,
    theta: Float[Tensor, " p"],
    problem: TrackingProblem,
    start: Unknowns,
    settings: LevenbergMarquardt | None = None,
) -> TrackingSolution:
    """Infer the initial condition and the rates of each track, θ fixed.

    Args:
        simulator: Model and residuals.
        theta: θ.
        problem: The tracks.
        start: First guess, e.g. `problem.guess`.
        settings: Of the solver.

    Returns:
        The unknowns of least cost, without gaps between shooting intervals.

    Raises:
        ValueError: The guess gives no finite cost.
    """
    solution = infer_controls_with_gaps(simulator, theta, problem, start, settings)
    return close_gaps(simulator, theta, problem, solution)


def close_gaps(
    simulator: TrackSimulator,
    theta: Float[Tensor, " p"],
    problem: TrackingProblem,
    solution: TrackingSolution,
) -> TrackingSolution:
    """The same controls without gaps between shooting intervals."""
    continuous = simulator.simulate_continuous(theta, problem, solution.unknowns)
    return solution._replace(**continuous._asdict())


def infer_controls_with_gaps(
    simulator: TrackSimulator,
    theta: Float[Tensor, " p"],
    problem: TrackingProblem,
    start: Unknowns,
    settings: LevenbergMarquardt | None = None,
) -> TrackingSolution:
    """As `infer_controls`, but the gaps of the last iteration stay; each track has its damping.

    Raises:
        ValueError: The guess gives no finite cost.
    """
    settings = settings or LevenbergMarquardt()
    unknowns, now = start, simulator.simulate(theta, problem, start)
    bad = int((~now.cost.isfinite()).sum())
    require(bad == 0, "tracks", "give a finite cost", f"{bad} that do not")
    damping = torch.full_like(now.cost, FIRST_DAMPING)
    done = torch.zeros_like(now.cost, dtype=torch.bool)
    weights = torch.zeros_like(now.gap)
    for _ in range(settings.max_iterations):
        jacobian = simulator.jacobian(theta, problem, unknowns, now, shared=False)
        closing = torch.where(done, 0.0, gap_closure(damping))
        system = normal_equations(jacobian, now.residual, unknowns, closing)
        local = solve_arrowhead(system.damped(damping, damping.new_zeros(()))).local
        step = ShootingStep(torch.where(done.unsqueeze(-1), 0.0, local), theta[:0], closing)
        here = LinearisedTracks(unknowns, now, jacobian)
        trial = try_step(simulator, theta, problem, here, step, weights)
        weights, better = trial.weights, trial.decrease > 0
        unknowns = choose_per_track(better, trial.unknowns, unknowns)
        now = choose_per_track(better, trial.simulated, now)
        small = trial.predicted_decrease <= settings.tolerance * now.cost
        done = done | small | (damping > MOST_DAMPING)
        damping = damping * damping_factor(trial.decrease / trial.predicted_decrease)
        damping = damping.clamp_min(LEAST_DAMPING)
        if bool(done.all()):
            break
    return TrackingSolution(unknowns, now, done)


def damping_factor(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Factor of the damping from the ratio of the decrease to the predicted one.

    At a ratio of about one half the damping stays: where residuals have kinks (a vehicle drives by
    one wheel and brakes by two), less damping would only overshoot.
    """
    kept = torch.where(ratio > GOOD_RATIO, 0.1, torch.ones_like(ratio))
    return torch.where(ratio > POOR_RATIO, kept, 10.0)


def position_error(
    simulator: TrackSimulator, states: Float[Tensor, "N T1 s"], measurements: Measurements
) -> Float[Tensor, "N T1"]:
    """Distance in m between the reference point and the track, zero in the padding."""
    plain, _, control = simulator.vehicle.split(states)
    position = simulator.vehicle.model.motion(plain, control).position
    return (position - measurements.position).norm(dim=-1) * measurements.weight


def tracking_rmse(
    simulator: TrackSimulator, states: Float[Tensor, "N T1 s"], measurements: Measurements
) -> Float[Tensor, " N"]:
    """Root mean square distance of each track in m."""
    squares = position_error(simulator, states, measurements).square().sum(-1)
    return (squares / measurements.weight.sum(-1)).sqrt()
