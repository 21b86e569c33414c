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
    adhesion: float  # share of μ g that is used, with μ = 0.8 where the model has none


def measure_excitation(
    simulator: TrackSimulator,
    problem: TrackingProblem,
    simulated: TrackSimulation,
    friction: float = 0.8,
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
    )


def _top_quantile(values: Float[Tensor, " n"]) -> float:
    return float(torch.quantile(values, TOP_QUANTILE))
