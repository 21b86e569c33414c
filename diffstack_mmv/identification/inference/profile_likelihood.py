"""Profile likelihoods: how well the tracks can be explained for each value of one parameter."""

from collections.abc import Sequence
from typing import NamedTuple

import torch

from diffstack_mmv.checks import require_one_of
from diffstack_mmv.identification.inference.identifier import Identification
from diffstack_mmv.identification.shooting.fit import (
    EstimationData,
    FitMethod,
    ParameterFit,
    total_cost,
    with_parameters,
)
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator

PROFILED_SHARE = 0.96  # of the range that a profile covers


class ProfileLikelihood(NamedTuple):
    """Least cost over values of one parameter, all other parameters and the controls fitted."""

    values: tuple[float, ...]
    costs: tuple[float, ...]


@torch.no_grad()
def profile_likelihoods(
    simulator: TrackSimulator,
    data: EstimationData,
    found: Identification,
    method: FitMethod,
    names: Sequence[str],
    points: int = 9,
) -> dict[str, ProfileLikelihood]:
    """Profile the cost, tracks and priors of the others together, over the range of parameters.

    Each value starts from its neighbor's solution, outwards from the estimate. Held-out tracks stop
    none of the fits: their solution is that of another value.

    Args:
        simulator: Model and residuals.
        data: The tracks.
        found: The identification.
        method: Algorithm that fits the other parameters.
        names: Parameters to profile.
        points: Number of values.

    Raises:
        ValueError: A name is not one of the learned parameters.
    """
    for name in names:
        require_one_of("profile", name, simulator.parameters.names)
    return {name: _profile(simulator, data, found, method, name, points) for name in names}


def _profile(
    simulator: TrackSimulator,
    data: EstimationData,
    found: Identification,
    method: FitMethod,
    name: str,
    points: int,
) -> ProfileLikelihood:
    parameters = simulator.parameters
    index = parameters.names.index(name)
    middle, half = float(parameters.middle[index]), float(parameters.half[index])
    grid = [middle + half * PROFILED_SHARE * (2 * i / (points - 1) - 1) for i in range(points)]
    estimate = float(parameters.values(found.after.theta)[index])
    active = torch.ones(len(parameters), dtype=torch.bool)
    active[index] = False
    costs: dict[float, float] = {}
    method = method.unstopped()
    above = [value for value in grid if value >= estimate]
    below = [value for value in reversed(grid) if value < estimate]
    for side in (above, below):
        fit = found.after
        for value in side:
            fit = method(simulator, data, _at(simulator, data, fit, index, value), active)
            penalty = 0.5 * float(parameters.penalty(fit.theta)[index]) ** 2
            costs[value] = total_cost(simulator, fit) - penalty
    return ProfileLikelihood(tuple(grid), tuple(costs[value] for value in grid))


def _at(
    simulator: TrackSimulator, data: EstimationData, fit: ParameterFit, index: int, value: float
) -> ParameterFit:
    """The fit with one value changed, controls as they were."""
    parameters = simulator.parameters
    values = parameters.values(fit.theta)
    values[index] = value
    theta = fit.theta.clone()
    theta[index] = parameters.theta_for(values)[index]
    return with_parameters(simulator, data, fit, theta)
