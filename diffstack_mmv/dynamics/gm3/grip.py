"""What tyres hold of a turn that is asked for while braking or accelerating."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.types import GRAVITY

GRIP_SHARE = 0.65  # of μ g, for accelerations along and across together
SLOW_MPS = 0.2  # below, every curvature is held


def within_grip(
    curvature: Float[Tensor, "*#b"],
    speed: Float[Tensor, "*#b"],
    acceleration: Float[Tensor, "*#b"],
    friction: Float[Tensor, " wheels"],
) -> Float[Tensor, "*b"]:
    """The part of a curvature in 1/m that the tyres hold: |a| + v² |κ| ≤ 0.65 μ g.

    A friction circle would let too much through: braking unloads the rear wheel, and a motorcycle
    at 14 m/s spins where it brakes by 3 m/s² in a turn of 5 m/s², 0.66 of μ g. With 0.7 μ g it
    still spins at 20 m/s, with 0.65 neither motorcycle, bicycle nor e-scooter does.

    Args:
        curvature: What is asked, 1/m.
        speed: In m/s.
        acceleration: What is asked along the path, m/s².
        friction: μ of each wheel.
    """
    grip = GRIP_SHARE * GRAVITY * friction.mean()
    across = (grip - acceleration.abs()).clamp_min(0)
    limit = across / (speed.square() + SLOW_MPS**2)
    return torch.minimum(torch.maximum(curvature, -limit), limit)
