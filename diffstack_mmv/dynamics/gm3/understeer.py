"""Quantities of the vehicle on linear tyres, as textbooks tell understeer by."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.chassis import Chassis, Physics
from diffstack_mmv.dynamics.gm3.steady import steer_command
from diffstack_mmv.dynamics.records import DerivedQuantity
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import VehicleSpec
from diffstack_mmv.vehicles.layout import SAME_PLACE_M

PACE_MPS = 5.0  # speed at which the steering per curvature is told
SLIGHT = 1e-4  # 1/m, a curvature at which everything is linear


def steer_per_curvature(chassis: Chassis, physics: Physics) -> dict[str, DerivedQuantity]:
    """Steering angle in rad per curvature in 1/m at `PACE_MPS`, by its name."""
    pace, slight = chassis.get_buffer("x").new_tensor([PACE_MPS, SLIGHT])
    steer = steer_command(chassis, physics, pace, slight) / slight
    return {f"steer_per_curvature_at_{PACE_MPS:g}_mps": DerivedQuantity(steer, "m")}


def axle_quantities(
    spec: VehicleSpec,
    tread_stiffness: Float[Tensor, " wheels"],
    contact_half_length: Float[Tensor, " wheels"],
) -> dict[str, DerivedQuantity]:
    """Normalised cornering stiffness C / F_z of both axles, and the understeer gradient.

        K = m / L (l_r / C_f - l_f / C_r),   C = 2 c_p ℓ²

    Args:
        spec: The vehicle.
        tread_stiffness: c_p of each wheel in N/m².
        contact_half_length: ℓ of each wheel in m.

    Returns:
        The quantities by name; none where one of the axles carries no lateral force, or where
        wheels stand elsewhere than on two axles.
    """
    places = [wheel.x_m for wheel in spec.wheels]
    ends = (spec.front_m, -spec.rear_m)
    on_axles = all(min(abs(x - end) for end in ends) < SAME_PLACE_M for x in places)
    if spec.front_m <= 0 or not on_axles or any(wheel.caster for wheel in spec.wheels):
        return {}
    cornering_stiffness = 2 * tread_stiffness * contact_half_length.square()
    ahead = torch.tensor([x > 0 for x in places])
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
