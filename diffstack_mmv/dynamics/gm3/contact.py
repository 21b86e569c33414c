"""What happens where the wheels touch the ground, split by how fast it changes within a step."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.drive import Traction
from diffstack_mmv.dynamics.gm3.tire import TireProperties, TireSecants, TireSlip


class Grip(NamedTuple):
    """What speed, lean and command decide; side-slip, the fast part, hardly changes it."""

    normal_load: Float[Tensor, "all n"]  # N, of all wheels
    tire: TireProperties
    traction: Traction
    inverse_speed: Float[Tensor, "wheels n"]  # V_x / (V_x² + v_ε²) in s/m
    camber: Float[Tensor, "wheels n"] | None  # V_x times the spin of the lean, 1/s
    trail_sign: Float[Tensor, "wheels n"]  # V_x / sqrt(V_x² + v_ε²)


class Contact(NamedTuple):
    """Slips of the rolling wheels and the secants of the tyre law there."""

    grip: Grip
    slip: TireSlip
    angle_ratio: Float[Tensor, "wheels n"] | None  # α / (-V_y) in s/m
    secants: TireSecants
