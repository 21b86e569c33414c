"""A governor: the drive of a vehicle pushes no further than to its top speed."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.dynamics import AccelerationRange, DynamicsModel


class Governor:
    """Cuts the acceleration of a control so that a step ends within the top speed.

    A control beyond changes nothing, and has no derivative there.

    Args:
        model: The vehicle, driven by an acceleration, one of whose steps it is.
        speed_max_mps: Top speed, ahead and backwards.

    Raises:
        ValueError: The model is not driven by an acceleration, or the top speed not positive.
    """

    def __init__(self, model: DynamicsModel, speed_max_mps: float) -> None:
        require_positive("speed_max_mps", speed_max_mps)
        names = list(model.Control._fields)
        remedy = "A top speed needs a model that is driven by an acceleration."
        require("acceleration" in names, "controls", "contain acceleration", names, remedy=remedy)
        self.model = model
        self.speed_max_mps = speed_max_mps
        self.column = names.index("acceleration")

    def __call__(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b m"]:
        """What acts of a control in a state."""
        least, most = self.range(state, self.model.dt_s)
        columns = list(control.unbind(dim=-1))
        columns[self.column] = torch.clamp(columns[self.column], least, most)
        return torch.stack(columns, dim=-1)

    def range(self, state: Float[Tensor, "*b n"], dt_s: float) -> AccelerationRange:
        """Accelerations in m/s² that end within the top speed after a time in s."""
        resting = state.new_zeros(*state.shape[:-1], self.model.control_dim)
        speed = self.model.motion(state, resting).velocity[..., 0]
        top = self.speed_max_mps
        return AccelerationRange((-top - speed) / dt_s, (top - speed) / dt_s)
