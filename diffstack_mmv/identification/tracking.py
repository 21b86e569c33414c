"""Controls that explain recorded tracks, for a vehicle that is known."""

import logging
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least, require_positive
from diffstack_mmv.identification.arrow import solve
from diffstack_mmv.identification.linearisation import (
    Simulated,
    Tracker,
    normal_equations,
)
from diffstack_mmv.identification.outlook import (
    Linearised,
    Step,
    attempt,
    closing_share,
    keep,
)
from diffstack_mmv.identification.problem import Problem, Targets, Unknowns

logger = logging.getLogger(__name__)

FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-9
MOST_DAMPING = 1e9
TRUSTED, DOUBTED = 0.75, 0.2  # shares of the promised decrease


class Tracked(NamedTuple):
    """Unknowns that explain tracks, and what follows from them."""

    unknowns: Unknowns
    simulated: Simulated
    converged: Bool[Tensor, " N"]


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Settings of the least-squares solver.

    Args:
        max_iterations: Limit of iterations.
        tolerance: Promised relative decrease of the cost at which a track has converged.

    Raises:
        ValueError: A number is not positive.
    """

    max_iterations: int = 30
    tolerance: float = 1e-5

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)
        require_positive("tolerance", self.tolerance)


def track(
    tracker: Tracker,
    theta: Float[Tensor, " p"],
    problem: Problem,
    start: Unknowns,
    settings: LevenbergMarquardt | None = None,
) -> Tracked:
    """Infer placement and rates of each track with θ held.

    Args:
        tracker: Model and residuals.
        theta: θ.
        problem: The tracks.
        start: First guess, e.g. `problem.guess`.
        settings: Of the solver.

    Returns:
        The unknowns of least cost, in one piece.

    Raises:
        ValueError: The guess gives no finite cost.
    """
    return in_one_piece(tracker, theta, problem, follow(tracker, theta, problem, start, settings))


def in_one_piece(
    tracker: Tracker, theta: Float[Tensor, " p"], problem: Problem, tracked: Tracked
) -> Tracked:
    """The same controls without gaps between segments."""
    driven = tracker.drive(theta, problem, tracked.unknowns)
    return tracked._replace(**driven._asdict())


def follow(
    tracker: Tracker,
    theta: Float[Tensor, " p"],
    problem: Problem,
    start: Unknowns,
    settings: LevenbergMarquardt | None = None,
) -> Tracked:
    """As `track`, each track damped for itself, but segments are left as far apart as they are.

    Raises:
        ValueError: The guess gives no finite cost.
    """
    settings = settings or LevenbergMarquardt()
    unknowns, now = start, tracker.simulate(theta, problem, start)
    bad = int((~now.cost.isfinite()).sum())
    require(bad == 0, "tracks", "give a finite cost", f"{bad} that do not")
    damping = torch.full_like(now.cost, FIRST_DAMPING)
    done = torch.zeros_like(now.cost, dtype=torch.bool)
    weights = torch.zeros_like(now.gap)
    for _ in range(settings.max_iterations):
        jacobian = tracker.jacobian(theta, problem, unknowns, now, shared=False)
        closing = torch.where(done, 0.0, closing_share(damping))
        arrow = normal_equations(jacobian, now.residual, unknowns, closing)
        own = solve(arrow.damped(damping, damping.new_zeros(()))).own
        step = Step(torch.where(done.unsqueeze(-1), 0.0, own), theta[:0], closing)
        here = Linearised(unknowns, now, jacobian)
        trial = attempt(tracker, theta, problem, here, step, weights)
        weights, better = trial.weights, trial.decrease > 0
        unknowns, now = keep(better, trial.unknowns, unknowns), keep(better, trial.simulated, now)
        small = trial.promised <= settings.tolerance * now.cost
        done = done | small | (damping > MOST_DAMPING)
        damping = damping * damping_factor(trial.decrease / trial.promised)
        damping = damping.clamp_min(LEAST_DAMPING)
        if bool(done.all()):
            break
    return Tracked(unknowns, now, done)


def damping_factor(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Change of the damping by how much of the promised decrease came true.

    A step that kept about half of its promise keeps its damping: where residuals have kinks (a
    vehicle drives by one wheel and brakes by two), less damping would only overshoot.
    """
    kept = torch.where(ratio > TRUSTED, 0.1, torch.ones_like(ratio))
    return torch.where(ratio > DOUBTED, kept, 10.0)


def position_error(
    tracker: Tracker, states: Float[Tensor, "N T1 s"], targets: Targets
) -> Float[Tensor, "N T1"]:
    """Distance in m between the reference point and the track, zero in the padding."""
    plain, _, control = tracker.vehicle.split(states)
    position = tracker.vehicle.model.motion(plain, control).position
    return (position - targets.position).norm(dim=-1) * targets.weight


def tracking_rmse(
    tracker: Tracker, states: Float[Tensor, "N T1 s"], targets: Targets
) -> Float[Tensor, " N"]:
    """Root mean square distance of each track in m."""
    squares = position_error(tracker, states, targets).square().sum(-1)
    return (squares / targets.weight.sum(-1)).sqrt()
