"""How hard the tracks work the vehicle: what the tyres are asked for."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.load import GRAVITY
from diffstack_mmv.identification.linearisation import Simulated, Tracker
from diffstack_mmv.identification.problem import Problem

TOP = 0.995  # quantile that stands for the largest value: a single sample may be noise


class Excitation(NamedTuple):
    """Largest demands of a set of tracks."""

    speed_mps: float
    lateral_mps2: float
    braking_mps2: float
    driving_mps2: float
    yaw_rate_radps: float
    adhesion: float  # share of μ g that is used, with μ = 0.8 where the model has none


def excitation(
    tracker: Tracker, problem: Problem, simulated: Simulated, friction: float = 0.8
) -> Excitation:
    """Largest speed, accelerations and share of the adhesion limit over all recorded samples.

    Args:
        tracker: Model of the tracks.
        problem: The tracks.
        simulated: States that explain them.
        friction: Friction coefficient μ.
    """
    recorded = problem.targets.weight > 0
    plain, intention, control = tracker.vehicle.split(simulated.states)
    speed = tracker.vehicle.model.motion(plain, control).velocity.norm(dim=-1)[recorded]
    along, curvature = intention[recorded].unbind(-1)
    lateral = (speed.square() * curvature).abs()
    demand = (lateral.square() + along.square()).sqrt() / (friction * GRAVITY)
    return Excitation(
        _top(speed),
        _top(lateral),
        max(_top(-along), 0.0),
        max(_top(along), 0.0),
        _top((speed * curvature).abs()),
        _top(demand),
    )


def _top(values: Float[Tensor, " n"]) -> float:
    return float(torch.quantile(values, TOP))
