"""How hard the tracks work the vehicle: what the tyres are asked for."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.shooting.linearisation import TrackSimulation, TrackSimulator
from diffstack_mmv.identification.shooting.problem import TrackingProblem
from diffstack_mmv.types import GRAVITY

TOP_QUANTILE = 0.995  # quantile that stands for the largest value: a single sample may be noise


class Excitation(NamedTuple):
    """Largest demands of a set of tracks."""

    speed_mps: float
    lateral_mps2: float
    braking_mps2: float
    driving_mps2: float
    yaw_rate_radps: float
    adhesion: float  # share of μ g that is used
    friction: float  # μ, the mean of the wheels


USUAL_FRICTION = 0.8
"""μ where the model has none."""


def friction_of(simulator: TrackSimulator, theta: Float[Tensor, " p"]) -> float:
    """Friction coefficient μ of a model, the mean of its wheels; `USUAL_FRICTION` if it has none.

    Args:
        simulator: Model of the tracks.
        theta: Its learned parameters; a friction that is not among them is that of the vehicle.
    """
    parameters = simulator.parameters
    known = simulator.vehicle.model.physical_parameters().get("friction")
    learned = [
        value
        for name, value in zip(parameters.names, parameters.values(theta), strict=True)
        if name.startswith("friction")
    ]
    if known is None:
        return USUAL_FRICTION
    return float((torch.stack(learned) if learned else known).detach().mean())


def measure_excitation(
    simulator: TrackSimulator,
    problem: TrackingProblem,
    simulated: TrackSimulation,
    friction: float,
) -> Excitation:
    """Largest speed, accelerations and share of the adhesion limit over all recorded samples.

    Args:
        simulator: Model of the tracks.
        problem: The tracks.
        simulated: States that explain them.
        friction: Friction coefficient μ.
    """
    recorded = problem.measurements.weight > 0
    plain, command, control = simulator.vehicle.split(simulated.states)
    speed = simulator.vehicle.model.motion(plain, control).velocity.norm(dim=-1)[recorded]
    along, curvature = command[recorded].unbind(-1)
    lateral = (speed.square() * curvature).abs()
    demand = (lateral.square() + along.square()).sqrt() / (friction * GRAVITY)
    return Excitation(
        _top_quantile(speed),
        _top_quantile(lateral),
        max(_top_quantile(-along), 0.0),
        max(_top_quantile(along), 0.0),
        _top_quantile((speed * curvature).abs()),
        _top_quantile(demand),
        friction,
    )


def _top_quantile(values: Float[Tensor, " n"]) -> float:
    return float(torch.quantile(values, TOP_QUANTILE))
