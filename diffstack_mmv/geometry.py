"""Angles, rotations and frames in the plane: y to the left of x, angles counter-clockwise."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.types import Motion


def wrap_angle(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Map an angle in rad to [-π, π)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def direction(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b 2"]:
    """Return the unit vector (cos, sin) of an angle in rad."""
    return torch.stack([angle.cos(), angle.sin()], -1)


def rotate(vector: Float[Tensor, "*b 2"], angle: Float[Tensor, "*#b"]) -> Float[Tensor, "*b 2"]:
    """Rotate vectors counter-clockwise by an angle in rad."""
    cosine, sine = angle.cos(), angle.sin()
    x, y = vector[..., 0], vector[..., 1]
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], -1)


def position_in_frame(
    position: Float[Tensor, "*b 2"], origin: Float[Tensor, "*#b 2"], heading: Float[Tensor, "*#b"]
) -> Float[Tensor, "*b 2"]:
    """Express world positions in m in a frame with the given origin (m) and heading (rad)."""
    return rotate(position - origin, -heading)


def position_from_frame(
    position: Float[Tensor, "*b 2"], origin: Float[Tensor, "*#b 2"], heading: Float[Tensor, "*#b"]
) -> Float[Tensor, "*b 2"]:
    """Express positions in m of a frame with this origin (m) and heading (rad) in the world."""
    return rotate(position, heading) + origin


def motion_in_frame(
    motion: Motion, origin: Float[Tensor, "*#b 2"], heading: Float[Tensor, "*#b"]
) -> Motion:
    """Express a motion in a fixed frame; body velocity and yaw rate do not depend on it."""
    return motion._replace(
        position=position_in_frame(motion.position, origin, heading),
        heading=wrap_angle(motion.heading - heading),
    )
