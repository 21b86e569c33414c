"""Steady turns of the linear vehicle: which steering angle holds a curvature.

Force and moment balance of a vehicle on linear tyres (C = 2 c_p ℓ², trail ℓ/3, turn slip and
camber as a lead of ℓ/3) at speed v and curvature κ, for the steering t and the side slip β:

    Σ C (s t - β - x κ) + Σ C (ℓ/3) φ = m v² κ
    Σ C (x - k_align ℓ/3) (s t - β - x κ) + Σ C x (ℓ/3) φ + servo = I_z d_yaw v κ

with φ = -κ + (1 - ε_γ) γ / R, γ = v² κ / g and s the angle of a wheel per angle of the command.
For two axles this is the understeer formula

    t = κ (L + K v² + ...),   K = m (l_r / C_f - l_f / C_r) / L
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.chassis import Chassis, Physics
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import DifferentialDrive

_SLOWEST = 0.3  # m/s; a differential drive at rest cannot turn on a curvature at all


def linear_steer(
    chassis: Chassis,
    physics: Physics,
    speed: Float[Tensor, " n"],
    curvature: Float[Tensor, " n"],
) -> Float[Tensor, " n"]:
    """Steering angle of the linear theory for a speed in m/s and a curvature in 1/m."""
    spec = chassis.spec
    pace = (speed.square() + _SLOWEST**2).sqrt()
    lateral = pace.square()
    stiffness = 3 * physics.cornering
    lead = physics.contact_half_length / 3
    x = chassis.get_buffer("x") * physics.length_scale
    arm = x - physics.aligning_gain * lead
    gains = chassis.get_buffer("steer_gain")
    # generalised force per curvature that the tyres have to make up for
    spin = torch.ones_like(pace)
    if spec.leans:
        spin = spin - chassis.get_buffer("camber_gain") * lateral / GRAVITY
    needed = spec.mass_kg * lateral + (stiffness * (x + lead * spin)).sum(0)
    moment = physics.yaw_inertia * physics.damping_rate * pace
    moment = moment + (stiffness * (arm * x + x * lead * spin)).sum(0)
    per_steer = (stiffness * gains).sum(0)
    turn_per_steer = (stiffness * arm * gains).sum(0)
    if isinstance(spec.steering, DifferentialDrive):
        servo = physics.yaw_inertia / spec.steering.yaw_time_constant_s * pace
        moment = moment + servo
        turn_per_steer = turn_per_steer + servo / spec.steering.virtual_wheelbase_m
    per_slip, turn_per_slip = stiffness.sum(0), (stiffness * arm).sum(0)
    # eliminate the side slip from  a t - c β = needed κ  and  b t - e β = moment κ
    numerator = needed * turn_per_slip - moment * per_slip
    denominator = per_steer * turn_per_slip - turn_per_steer * per_slip
    return numerator / denominator * curvature


def steer_command(
    chassis: Chassis,
    physics: Physics,
    speed: Float[Tensor, "*#b"],
    curvature: Float[Tensor, "*#b"],
) -> Float[Tensor, "*b"]:
    """Steering command in rad that holds a curvature in 1/m at a speed in m/s."""
    speed, curvature = torch.broadcast_tensors(speed, curvature)
    flat = (speed.reshape(-1), curvature.reshape(-1))
    tangent = linear_steer(chassis, physics, *flat).reshape(speed.shape)
    return chassis.steering.command_for(chassis.steering.angle_for(tangent))
