"""Controls that explain recorded tracks, for a vehicle that is known."""

import logging
from dataclasses import dataclass
from typing import Any, NamedTuple

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
    Step,
    closing_share,
    foresee,
    merit,
    penalty_weights,
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
    """Infer placement and rates of each track with θ held, each track damped for itself.

    Args:
        tracker: Model and residuals.
        theta: θ.
        problem: The tracks.
        start: First guess, e.g. `problem.guess`.
        settings: Of the solver.

    Returns:
        The unknowns of least cost.

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
        outlook = foresee(jacobian, now, unknowns, step)
        weights = penalty_weights(weights, outlook.multipliers)
        trial = tracker.simulate(theta, problem, outlook.unknowns)
        before, after = merit(now, weights), merit(trial, weights)
        left = now._replace(cost=outlook.cost, gap=(1 - closing)[:, None, None] * now.gap)
        promised = before - merit(left, weights)
        better = after < before
        done = done | (promised <= settings.tolerance * now.cost) | (damping > MOST_DAMPING)
        unknowns, now = keep(better, outlook.unknowns, unknowns), keep(better, trial, now)
        damping = damping * damping_factor((before - after) / promised)
        damping = damping.clamp_min(LEAST_DAMPING)
        if bool(done.all()):
            break
    driven = tracker.drive(theta, problem, unknowns)
    return Tracked(driven.unknowns, driven.simulated, done)


def damping_factor(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Change of the damping by how much of the promised decrease came true.

    A step that kept about half of its promise keeps its damping: where residuals have kinks (a
    vehicle drives by one wheel and brakes by two), less damping would only overshoot.
    """
    kept = torch.where(ratio > TRUSTED, 0.1, torch.ones_like(ratio))
    return torch.where(ratio > DOUBTED, kept, 10.0)


def keep(better: Bool[Tensor, " N"], new: Any, old: Any) -> Any:
    """Per track, the new record where it is better, else the old one."""
    pairs = zip(new, old, strict=True)
    return type(new)(
        *(torch.where(better.reshape(-1, *[1] * (n.dim() - 1)), n, o) for n, o in pairs)
    )


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
