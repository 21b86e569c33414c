"""Slip and spin of the wheels, finite at standstill and in reverse.

Slip is taken over |V_r|, so that forces brake in reverse as well, and regularised by v_ε. Inside of
this folder the batch is flattened and is the last dimension, after wheels and components: small
inner dimensions would make every operation slow.

Source:
    GM3, Eq. 8-9 with the missing -r y_i restored; DMMV, Sec. III.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.smooth import arctan_ratio


class WheelVelocity(NamedTuple):
    """Velocity of the wheel hubs in the wheels' own axes, m/s."""

    forward: Float[Tensor, "wheels n"]
    left: Float[Tensor, "wheels n"]


class WheelAxes(NamedTuple):
    """Generalised directions, in (v_x, v_y, r), of the forward and the leftward axis of each wheel.

        g = (cos δ, sin δ, x sin δ - y cos δ),   d = (-sin δ, cos δ, x cos δ + y sin δ)

    They map velocities to the wheels, V_x = g · v and V_y = d · v, and forces back to the body, so
    that power is conserved.
    """

    along: Float[Tensor, "3 wheels n"]  # g
    across: Float[Tensor, "3 wheels n"]  # d


def wheel_axes(
    x: Float[Tensor, "wheels 1"],
    y: Float[Tensor, "wheels 1"],
    sine: Float[Tensor, "wheels n"],
    cosine: Float[Tensor, "wheels n"],
) -> WheelAxes:
    """Directions of the wheels' axes from positions in m and steering angles."""
    along = torch.stack([cosine, sine, x * sine - y * cosine])
    across = torch.stack([-sine, cosine, x * cosine + y * sine])
    return WheelAxes(along, across)


def hub_velocity(axes: WheelAxes, velocity: Float[Tensor, "3 n"]) -> WheelVelocity:
    """Velocity of every hub from the body's (v_x, v_y, r)."""
    body = velocity.unsqueeze(1)
    return WheelVelocity((axes.along * body).sum(0), (axes.across * body).sum(0))


def rolling_speed(
    forward: Float[Tensor, "wheels n"], slip: Float[Tensor, "wheels n"], slip_speed: float
) -> Float[Tensor, "wheels n"]:
    """Circumferential speed V_r in m/s that gives a slip σ_x exactly.

        V_r = [V_x + σ sqrt(V_x² + (1 - σ²) v_ε²)] / (1 - σ²)

    solves

        σ = (V_r - V_x) / sqrt(V_r² + v_ε²)
    """
    rest = 1 - slip.square()
    root = (forward.square() + slip_speed**2 * rest).sqrt()
    return torch.addcmul(forward, slip, root) / rest


def reference_speed(rolling: Float[Tensor, "*b"], slip_speed: float) -> Float[Tensor, "*b"]:
    """Denominator of the slips, D = sqrt(V_r² + v_ε²) in m/s."""
    return (rolling.square() + slip_speed**2).sqrt()


def inverse_speed(
    forward: Float[Tensor, "wheels n"], slip_speed: float
) -> Float[Tensor, "wheels n"]:
    """Return V_x / (V_x² + v_ε²) in s/m, which is 1 / V_x away from standstill."""
    return forward / (forward.square() + slip_speed**2)


def slip_angle_ratio(hub: WheelVelocity, slip_speed: float) -> Float[Tensor, "wheels n"]:
    """Return α / (-V_y) in s/m, with α = atan2(-V_y, sqrt(V_x² + v_ε²)); finite without slip."""
    inverse = (hub.forward.square() + slip_speed**2).rsqrt()
    return inverse * arctan_ratio(hub.left * inverse)
