"""Slip and spin of the wheels, finite at standstill and in reverse.

Source: GM3, Eq. 8-9 with the missing -r y_i restored; DMMV, Sec. III. Slip is taken over |V_r|, so
    that forces brake in reverse as well, and regularised by v_ε.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.smooth import arctan_ratio


class WheelVelocity(NamedTuple):
    """Velocity of the wheel hubs in the wheels' own axes, m/s."""

    forward: Float[Tensor, "*b wheels"]
    left: Float[Tensor, "*b wheels"]


def wheel_axes(
    x: Float[Tensor, " wheels"],
    y: Float[Tensor, " wheels"],
    sine: Float[Tensor, "*b wheels"],
    cosine: Float[Tensor, "*b wheels"],
) -> Float[Tensor, "*b 2 3 wheels"]:
    """Generalised directions (in v_x, v_y, r) of the forward and the leftward axis of each wheel.

        g = (cos δ, sin δ, x sin δ - y cos δ),   d = (-sin δ, cos δ, x cos δ + y sin δ)

    They map velocities to the wheels, V_x = g · v and V_y = d · v, and forces back to the body, so
    that power is conserved.
    """
    along = torch.stack([cosine, sine, x * sine - y * cosine], -2)
    across = torch.stack([-sine, cosine, x * cosine + y * sine], -2)
    return torch.stack([along, across], -3)


def hub_velocity(
    axes: Float[Tensor, "*b 2 3 wheels"], velocity: Float[Tensor, "*b 3"]
) -> WheelVelocity:
    """Velocity of every hub from the body's (v_x, v_y, r)."""
    forward, left = (axes * velocity[..., None, :, None]).sum(-2).unbind(-2)
    return WheelVelocity(forward, left)


def rolling_speed(
    forward: Float[Tensor, "*b wheels"], slip: Float[Tensor, "*b wheels"], slip_speed: float
) -> Float[Tensor, "*b wheels"]:
    """Circumferential speed V_r in m/s that gives a slip σ_x exactly.

    V_r = [V_x + σ sqrt(V_x² + (1 - σ²) v_ε²)] / (1 - σ²) solves σ = (V_r - V_x) / sqrt(V_r² +
    v_ε²).
    """
    rest = 1 - slip.square()
    root = (forward.square() + slip_speed**2 * rest).sqrt()
    return torch.addcmul(forward, slip, root) / rest


def reference_speed(
    rolling: Float[Tensor, "*b wheels"], slip_speed: float
) -> Float[Tensor, "*b wheels"]:
    """Denominator of the slips, D = sqrt(V_r² + v_ε²) in m/s."""
    return (rolling.square() + slip_speed**2).sqrt()


def inverse_speed(
    forward: Float[Tensor, "*b wheels"], slip_speed: float
) -> Float[Tensor, "*b wheels"]:
    """Return V_x / (V_x² + v_ε²) in s/m, which is 1 / V_x away from standstill."""
    return forward / (forward.square() + slip_speed**2)


def slip_angle_ratio(hub: WheelVelocity, slip_speed: float) -> Float[Tensor, "*b wheels"]:
    """Return α / (-V_y) in s/m, with α = atan2(-V_y, sqrt(V_x² + v_ε²)); finite without slip."""
    inverse = (hub.forward.square() + slip_speed**2).rsqrt()
    return inverse * arctan_ratio(hub.left * inverse)
