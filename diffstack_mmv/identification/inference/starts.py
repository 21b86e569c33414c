"""Where the search for other optima begins.

Over the prior of tyres some vehicles oversteer so much that they spin at the speed of the tracks:
rear tyres a third as stiff as the front ones have a critical speed below that of a quick cyclist.
There, an error grows by orders of magnitude along a track; the linearised problem is without use,
and a fit wanders for as long as it may. Those points are passed over, and others drawn.
"""

import logging

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.problem import TrackingProblem

logger = logging.getLogger(__name__)

MAX_DEVIATIONS = 1.9  # prior deviations: the range ends at two
MOST_GROWTH = 10.0  # of errors along the tracks, beside that at the fit
DRAWN = 4  # points per start, at most


def sobol_starts(parameters: ParameterVector, count: int) -> Float[Tensor, "count p"]:
    """θ spread over the prior by a Sobol sequence, the same in every call."""
    engine = torch.quasirandom.SobolEngine(max(len(parameters), 1), scramble=True, seed=0)
    # an engine cannot draw zero points
    uniform = engine.draw(max(count, 1), dtype=parameters.middle.dtype)[:count, : len(parameters)]
    deviations = torch.special.ndtri(uniform).clamp(-MAX_DEVIATIONS, MAX_DEVIATIONS)
    return parameters.theta_for(parameters.prior.mean + deviations * parameters.prior.std)


@torch.no_grad()
def error_growth(
    simulator: TrackSimulator, theta: Float[Tensor, " p"], problem: TrackingProblem
) -> float:
    """Largest derivative of a residual by an unknown of its track, along the recorded tracks.

    Args:
        simulator: Model and residuals.
        theta: θ.
        problem: The tracks.

    Returns:
        The derivative, in standard deviations of both; infinite where it is not finite.
    """
    simulated = simulator.simulate(theta, problem, problem.guess)
    jacobian = simulator.jacobian(theta, problem, problem.guess, simulated, shared=False)
    largest = float(jacobian.local.abs().max())
    return largest if largest < torch.inf else torch.inf


def calm_starts(
    simulator: TrackSimulator,
    problem: TrackingProblem,
    theta: Float[Tensor, " p"],
    active: Bool[Tensor, " p"],
    count: int,
) -> list[Float[Tensor, " p"]]:
    """Points spread over the prior at which errors do not grow far more than at a fit.

    Args:
        simulator: Model and residuals.
        problem: The fitted tracks.
        theta: θ of the fit; its values that are not fitted stay.
        active: Which values are fitted.
        count: How many points.

    Returns:
        At most `count` points; fewer where `DRAWN` times as many do not hold enough.
    """
    bound = MOST_GROWTH * error_growth(simulator, theta, problem)
    found: list[Tensor] = []
    passed_over = 0
    for drawn in sobol_starts(simulator.parameters, DRAWN * count):
        start = torch.where(active, drawn, theta)
        if error_growth(simulator, start, problem) <= bound:
            found.append(start)
        else:
            passed_over += 1
        if len(found) == count:
            break
    if passed_over:
        logger.info("%d starts at which the vehicle spins were passed over", passed_over)
    return found
