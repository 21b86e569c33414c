"""Quantities of the two-axle vehicle on linear tyres, as textbooks tell understeer by."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.records import DerivedQuantity
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import VehicleSpec


def axle_quantities(
    spec: VehicleSpec, cornering_stiffness: Float[Tensor, " wheels"]
) -> dict[str, DerivedQuantity]:
    """Normalised cornering stiffness C / F_z of both axles, and the understeer gradient.

        K = m / L (l_r / C_f - l_f / C_r)

    Args:
        spec: The vehicle.
        cornering_stiffness: C of each wheel in N/rad.

    Returns:
        The quantities by name; none where one of the axles carries no lateral force.
    """
    if spec.front_m <= 0 or any(wheel.caster for wheel in spec.wheels):
        return {}
    ahead = torch.tensor([wheel.x_m > 0 for wheel in spec.wheels])
    front, rear = cornering_stiffness[ahead].sum(), cornering_stiffness[~ahead].sum()
    wheelbase = spec.front_m + spec.rear_m
    weight = spec.mass_kg * GRAVITY
    front_load = weight * spec.rear_m / wheelbase
    rear_load = weight * spec.front_m / wheelbase
    gradient = spec.mass_kg / wheelbase * (spec.rear_m / front - spec.front_m / rear)
    return {
        "normalised_cornering_stiffness.front": DerivedQuantity(front / front_load, "1/rad"),
        "normalised_cornering_stiffness.rear": DerivedQuantity(rear / rear_load, "1/rad"),
        "understeer_gradient": DerivedQuantity(gradient, "rad s^2/m"),
    }
