"""What instruments record of the controls of a model."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel


def recorded_controls(
    model: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Float[Tensor, "*b m"]:
    """Acceleration (m/s²) and steering angle (rad) where a model is steered, else its control.

    DiffGM3 clamps its steering command softly: a command of 0.30 rad turns the wheel of a bicycle
    by 0.286 rad. An instrument tells the angle.

    Args:
        model: The dynamics.
        state: Its states.
        control: Its controls.
    """
    if "steer" not in model.Control._fields:
        return control
    return torch.stack(model.driver_input(state, control), -1)
