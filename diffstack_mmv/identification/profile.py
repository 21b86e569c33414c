"""Profile likelihoods: how well the tracks can be explained for each value of one parameter."""

from collections.abc import Sequence
from typing import NamedTuple

import torch

from diffstack_mmv.checks import require_one_of
from diffstack_mmv.identification.fit import Data, Fit, Method, moved_to, total_cost
from diffstack_mmv.identification.identify import Identification
from diffstack_mmv.identification.linearisation import Tracker

SHARE = 0.96  # of the range that a profile covers


class Profile(NamedTuple):
    """Least cost over values of one parameter, all others and the controls free."""

    values: tuple[float, ...]
    costs: tuple[float, ...]


@torch.no_grad()
def profiles(
    tracker: Tracker,
    data: Data,
    found: Identification,
    method: Method,
    names: Sequence[str],
    points: int = 9,
) -> dict[str, Profile]:
    """Profile the cost, tracks and priors of the others together, over the range of parameters.

    Each value starts from its neighbor's solution, outwards from the estimate.

    Args:
        tracker: Model and residuals.
        data: The tracks.
        found: The identification.
        method: Fits what is free.
        names: Parameters to profile.
        points: Number of values.

    Raises:
        ValueError: A name is not among the learned numbers.
    """
    for name in names:
        require_one_of("profile", name, tracker.parameters.names)
    return {name: _profile(tracker, data, found, method, name, points) for name in names}


def _profile(
    tracker: Tracker, data: Data, found: Identification, method: Method, name: str, points: int
) -> Profile:
    parameters = tracker.parameters
    index = parameters.names.index(name)
    middle, half = float(parameters.middle[index]), float(parameters.half[index])
    grid = [middle + half * SHARE * (2 * i / (points - 1) - 1) for i in range(points)]
    estimate = float(parameters.values(found.after.theta)[index])
    active = torch.ones(len(parameters), dtype=torch.bool)
    active[index] = False
    costs: dict[float, float] = {}
    above = [value for value in grid if value >= estimate]
    below = [value for value in reversed(grid) if value < estimate]
    for side in (above, below):
        fit = found.after
        for value in side:
            fit = method(tracker, data, _at(tracker, data, fit, index, value), active)
            penalty = 0.5 * float(parameters.penalty(fit.theta)[index]) ** 2
            costs[value] = total_cost(tracker, fit) - penalty
    return Profile(tuple(grid), tuple(costs[value] for value in grid))


def _at(tracker: Tracker, data: Data, fit: Fit, index: int, value: float) -> Fit:
    """The fit with one number moved, controls as they were."""
    parameters = tracker.parameters
    values = parameters.values(fit.theta)
    values[index] = value
    theta = fit.theta.clone()
    theta[index] = parameters.theta_for(values)[index]
    return moved_to(tracker, data, fit, theta)
