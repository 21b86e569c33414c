"""Side slip of a vehicle of which only the course is known."""

import torch
from jaxtyping import Float
from torch import Tensor

SLOW_MPS = 0.2  # below, a course says little about the heading


def side_slip(
    speed: Float[Tensor, "*#b"], yaw_rate: Float[Tensor, "*#b"], turning_axle_m: float
) -> Float[Tensor, "*b"]:
    """Angle β in rad from heading to course, where the axle that does not steer rolls freely.

    That axle at x_a does not slip sideways: sin β = -x_a r / v. Near standstill, where a course
    says little, β fades to zero.

    Args:
        speed: v along the course in m/s.
        yaw_rate: r in rad/s.
        turning_axle_m: x_a, position of the axle ahead of the centre of gravity.
    """
    ratio = -turning_axle_m * yaw_rate * speed / (speed.square() + SLOW_MPS**2)
    # the arcsine of the softly limited ratio S(x), as a tangent that is smooth everywhere
    square = ratio.square()
    return torch.atan(ratio * (square + (1 + square.square()).sqrt()).sqrt())
