"""The interface of a dynamics model: one control step, and its meaning as planar motion."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_columns, require_positive
from diffstack_mmv.types import Bounds, Motion
from diffstack_mmv.vehicles import SoftClamped


class DynamicsModel(nn.Module, ABC):
    """A vehicle as x⁺ = f(x, u; ρ) with the control held over `dt_s` seconds.

    A model names its columns by two named tuples and writes `step`, `motion`, `initial_state` and
    `control_for`; checks, bounds and the view on the physical parameters ρ live here. All methods
    take any leading dimensions, work under `torch.func` transforms and `torch.compile`, and are
    differentiable in state, control and parameters.

    Args:
        dt_s: Length of one step in s.
        control_lower: Lower end of the box of admissible controls, one number per control, SI
            units.
        control_upper: Upper end of the box.

    Raises:
        ValueError: The step is not positive, or a bound is missing or reversed.
    """

    State: ClassVar[Any]
    Control: ClassVar[Any]

    def __init__(
        self, dt_s: float, control_lower: Sequence[float], control_upper: Sequence[float]
    ) -> None:
        super().__init__()
        require_positive("dt_s", dt_s)
        for name, low, high in zip(self.Control._fields, control_lower, control_upper, strict=True):
            require(low < high, f"bounds of {name}", "be in rising order", (low, high))
        self.dt_s = dt_s
        self.register_buffer("_lower", torch.tensor(control_lower), persistent=False)
        self.register_buffer("_upper", torch.tensor(control_upper), persistent=False)

    @property
    def state_dim(self) -> int:
        """Number of state columns n."""
        return len(self.State._fields)

    @property
    def control_dim(self) -> int:
        """Number of control columns m."""
        return len(self.Control._fields)

    @property
    def bounds(self) -> Bounds:
        """Box of admissible controls (m,), SI units."""
        return Bounds(self.get_buffer("_lower"), self.get_buffer("_upper"))

    def forward(
        self, state: Float[Tensor, "*#b n"], control: Float[Tensor, "*#b m"]
    ) -> Float[Tensor, "*b n"]:
        """Advance by one control step.

        Raises:
            ValueError: State or control has the wrong number of columns.
        """
        require_columns("state", state, self.state_dim, self.State._fields)
        require_columns("control", control, self.control_dim, self.Control._fields)
        return self.step(state, control)

    @abstractmethod
    def step(
        self, state: Float[Tensor, "*#b n"], control: Float[Tensor, "*#b m"]
    ) -> Float[Tensor, "*b n"]:
        """Advance by one control step, arguments already checked."""

    @abstractmethod
    def motion(self, states: Float[Tensor, "*b n"], controls: Float[Tensor, "*b m"]) -> Motion:
        """Motion of the model's reference point, in m, rad, m/s and rad/s."""

    @abstractmethod
    def initial_state(self, motion: Motion) -> Float[Tensor, "*b n"]:
        """State with this pose and velocity; internal states take their steady values."""

    @abstractmethod
    def control_for(
        self,
        state: Float[Tensor, "*b n"],
        acceleration: Float[Tensor, "*b"],
        curvature: Float[Tensor, "*b"],
    ) -> Float[Tensor, "*b m"]:
        """Control within the bounds that holds an acceleration (m/s²) and a curvature (1/m)."""

    def state_on_course(self, motion: Motion) -> Float[Tensor, "*b n"]:
        """State of a vehicle whose reference point was tracked: its heading is its course.

        A point that slips no sideways, as here by default, has heading and course equal.
        """
        return self.initial_state(motion)

    def within_bounds(self, control: Float[Tensor, "*b m"]) -> Float[Tensor, "*b m"]:
        """Clip controls to the box."""
        return torch.minimum(torch.maximum(control, self.bounds.lower), self.bounds.upper)

    def physical_parameters(self) -> dict[str, Tensor]:
        """Values of all physical parameters in physical units by their names, learned or frozen."""
        return {
            name: module()
            for name, module in self.named_modules()
            if isinstance(module, SoftClamped)
        }
