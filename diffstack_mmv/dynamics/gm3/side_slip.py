"""Side slip of a vehicle of which only the course is known."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.types import Motion

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


def body_motion(motion: Motion, turning_axle_m: float) -> Motion:
    """Motion of the body of a vehicle, from that along its course.

    Args:
        motion: `heading` is the course in rad, the forward velocity the speed along it in m/s.
        turning_axle_m: As in `side_slip`.
    """
    speed = motion.velocity[..., 0]
    beta = side_slip(speed, motion.yaw_rate, turning_axle_m)
    turned = torch.stack([speed * beta.cos(), speed * beta.sin()], -1)
    return motion._replace(heading=motion.heading - beta, velocity=turned)
