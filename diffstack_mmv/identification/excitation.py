"""How hard the tracks work the vehicle: what the tyres are asked for."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.load import GRAVITY
from diffstack_mmv.identification.linearisation import Simulated, Tracker
from diffstack_mmv.identification.problem import Problem
from diffstack_mmv.identification.stretches import Stretch
from diffstack_mmv.vehicles import Limits

OVER_S = 0.4  # accelerations of recorded tracks are means over that long
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


def beyond_limits(stretches: Sequence[Stretch], limits: Limits, dt_s: float) -> float:
    """Share of the recorded samples whose acceleration along the track no command can give.

    Args:
        stretches: The tracks.
        limits: Of the vehicle.
        dt_s: Step of the tracks.
    """
    lag = max(round(OVER_S / dt_s), 1)
    along = torch.cat([(each.speed[lag:] - each.speed[:-lag]) / (lag * dt_s) for each in stretches])
    low, high = limits.acceleration_min_mps2, limits.acceleration_max_mps2
    return float(((along < low) | (along > high)).double().mean())


def _top(values: Float[Tensor, " n"]) -> float:
    return float(torch.quantile(values, TOP))
