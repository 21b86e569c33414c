"""Wheel positions that are known no better than the wheelbase.

DiffGM3 takes the positions of its wheels from the vehicle. Taken for exact they give away the
steering per curvature at every speed: rides at one speed tell understeer, and the positions all
others. So positions are as uncertain as the wheelbase of the same vehicle is said to be.
"""

from dataclasses import replace

from torch import nn

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.vehicles import SoftClamped, VehicleSpec

LENGTH_SCALE = "length_scale"  # factor on all longitudinal wheel positions
SOURCE = "wheel positions as given; range as that of the wheelbase"


def with_uncertain_positions(spec: VehicleSpec) -> VehicleSpec:
    """The vehicle with a length scale of the range of its wheelbase, where it has none of its own.

    Args:
        spec: The vehicle.
    """
    own, wheelbase = spec.parameters[LENGTH_SCALE], spec.wheelbase
    ((initial, low, high),) = wheelbase.entries()
    if own.learn or not wheelbase.learn or not low < high:
        return spec
    ((scale, _, _),) = own.entries()
    ends = {"low": scale * low / initial, "high": scale * high / initial}
    uncertain = replace(own, **ends, learn=True, source=SOURCE)
    return replace(spec, parameters={**spec.parameters, LENGTH_SCALE: uncertain})


def free_positions(model: DynamicsModel, spec: VehicleSpec) -> None:
    """Let a model that has a length scale learn it, within the range of a vehicle.

    Args:
        model: The dynamics.
        spec: The vehicle, from `with_uncertain_positions`.
    """
    fixed = dict(model.named_children()).get(LENGTH_SCALE)
    if isinstance(fixed, SoftClamped) and not fixed.spec.learn:
        free: nn.Module = SoftClamped(spec.parameters[LENGTH_SCALE])
        model.add_module(LENGTH_SCALE, free.to(fixed.offset))
