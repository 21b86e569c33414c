"""The interface of a dynamics model: one control step, and its meaning as planar motion."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from typing import Any, ClassVar, Self

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import (
    message,
    require,
    require_columns,
    require_positive,
    require_precision,
)
from diffstack_mmv.dynamics.records import (
    AccelerationRange,
    DerivedQuantity,
    DriverInput,
    WheelForces,
)
from diffstack_mmv.types import Bounds, Motion
from diffstack_mmv.vehicles import ExactBuffers, SoftClamped


class DynamicsModel(ExactBuffers, ABC):
    """A vehicle as x⁺ = f(x, u; ρ) with the control held over `dt_s` seconds.

    A model names its columns by two named tuples and writes `step`, `motion`, `initial_state` and
    `control_for`; checks, bounds and the view on the physical parameters ρ live here. All methods
    take any leading dimensions, work under `torch.func` transforms and `torch.compile`, and are
    differentiable in state, control and parameters.

    What stands under "what a new model has to think about" has defaults: each tells for which
    models it is right. A default that would be a guess refuses instead.

    Args:
        dt_s: Length of one step in s.
        control_lower: Lower end of the box of admissible controls, one number per control, SI
            units.
        control_upper: Upper end of the box.

    Attributes:
        control_lower: Lower end of the box as it was given, from which `bounds` are made in every
            precision.
        control_upper: Upper end of it.

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
        names = self.Control._fields
        for which, box in (("control_lower", control_lower), ("control_upper", control_upper)):
            wanted = f"hold a number for each of {', '.join(names)}"
            require(len(box) == len(names), which, wanted, list(box))
        for name, low, high in zip(names, control_lower, control_upper, strict=True):
            require(low < high, f"bounds of {name}", "be in rising order", (low, high))
        self.dt_s = dt_s
        self.control_lower, self.control_upper = tuple(control_lower), tuple(control_upper)
        self.register_exact("_lower", self.control_lower)
        self.register_exact("_upper", self.control_upper)

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

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Move or convert the model.

        Raises:
            TypeError: The new type is half precision.
        """
        asked = fn(self.get_buffer("_lower")).dtype
        remedy = "A predictor can work in mixed precision: stack=mixed_precision."
        require_precision("dtype", asked, f"for {type(self).__name__}", remedy)
        return super()._apply(fn, recurse)

    def forward(
        self, state: Float[Tensor, "*#b n"], control: Float[Tensor, "*#b m"]
    ) -> Float[Tensor, "*b n"]:
        """Advance by one control step.

        Raises:
            ValueError: State or control has the wrong number of columns, or their leading
                dimensions do not fit each other.
        """
        return self.step(*self._fitting(state, control))

    @abstractmethod
    def step(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b n"]:
        """Advance by one control step, arguments already checked and of the same batch."""

    @abstractmethod
    def motion(self, states: Float[Tensor, "*b n"], controls: Float[Tensor, "*b m"]) -> Motion:
        """Motion of the model's reference point, in m, rad, m/s and rad/s."""

    @abstractmethod
    def initial_state(self, motion: Motion) -> Float[Tensor, "*b n"]:
        """State with this pose and velocity; internal states take their steady values."""

    @abstractmethod
    def control_for(
        self,
        state: Float[Tensor, "*#b n"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b m"]:
        """Control within the bounds that holds an acceleration (m/s²) and a curvature (1/m)."""

    def curvature_within_grip(
        self,
        state: Float[Tensor, "*b n"],
        acceleration: Float[Tensor, "*b"],
        curvature: Float[Tensor, "*b"],
    ) -> Float[Tensor, "*b"]:
        """What of a curvature (1/m) the tyres hold beside an acceleration (m/s²).

        All of it, as here by default, where a model has no tyres that could slide.
        """
        return curvature

    def state_on_course(self, motion: Motion) -> Float[Tensor, "*b n"]:
        """State of a vehicle whose reference point was tracked: its heading is its course.

        A point that slips no sideways, as here by default, has heading and course equal.
        """
        return self.initial_state(motion)

    # what a new model has to think about

    def lengthened(self, repeats: int) -> Self:
        """The model with so many steps as one, which shares its parameters.

        For what a control means that is held so long: a model whose `control_for` needs the step
        takes the longer one, as here by default. One that tries a step there takes its own steps
        within it.
        """
        # a copy of a module shares the mappings of its parameters
        longer = copy(self)
        longer.dt_s = self.dt_s * repeats
        return longer

    @property
    def reference_ahead_m(self) -> float:
        """Distance in m of the reference point ahead of the centre of gravity, negative behind it.

        Zero by default: the reference point is the centre of gravity.
        """
        return 0.0

    @property
    def longest_step_s(self) -> float:
        """Longest step in s at which the numerical scheme may be used within a plan.

        Without limit by default: the scheme is exact or implicit.
        """
        return math.inf

    @property
    def acts_a_step_late(self) -> bool:
        """Whether a control moves the vehicle from the next step on only; not by default.

        So it does in an explicit Euler step, whose positions follow a control half a step later
        than those of a vehicle that moves in continuous time.
        """
        return False

    @property
    def moves_with_pose(self) -> bool:
        """Whether a moved and turned vehicle does the same, moved and turned; not by default.

        Its derivatives in position and heading are then known from the step itself.
        """
        return False

    @property
    def driver_input_needs_state(self) -> bool:
        """Whether what a control means to a driver depends on the state; true by default.

        It does for a yaw rate, which is another steering angle at every speed.
        """
        return True

    def useful_acceleration(self, state: Float[Tensor, "*b n"]) -> AccelerationRange | None:
        """Accelerations in m/s² between two speeds that the model does not leave.

        A step with the least ends at the lowest speed, one with the most at the highest; what is
        beyond changes the end of a step no more, and has no derivative. None, the default, for a
        model that bounds its speed nowhere, or smoothly.
        """
        return None

    @property
    def keeps_top_speed(self) -> bool:
        """Whether the model itself goes no faster than its vehicle may; not by default."""
        return False

    @property
    def can_reverse(self) -> bool:
        """Whether the vehicle drives backwards where it brakes on; not by default."""
        return False

    def hardest_braking(self, state: Float[Tensor, "*b n"]) -> Float[Tensor, "*b"]:
        """Acceleration in m/s² of the hardest braking over one step.

        The lower bound of the acceleration; of a model that can reverse no more than what stops it,
        and of one that is driven by no acceleration just that.
        """
        names = list(self.Control._fields)
        driven = "acceleration" in names
        if driven and not self.can_reverse:
            return self.bounds.lower[names.index("acceleration")].expand(state.shape[:-1])
        none = state.new_zeros(*state.shape[:-1], self.control_dim)
        stopping = -self.motion(state, none).velocity[..., 0] / self.dt_s
        if not driven:
            return stopping
        lower, upper = (bound[names.index("acceleration")] for bound in self.bounds)
        return torch.minimum(torch.maximum(stopping, lower), upper)

    def control_for_driver(
        self, state: Float[Tensor, "*b n"], driver: DriverInput
    ) -> Float[Tensor, "*b m"]:
        """Control, not clipped, that is a driver's acceleration (m/s²) and steering angle (rad).

        Raises:
            ValueError: The model does not say what a steering angle does, as by default.
        """
        raise ValueError(self._no_driver("control_for_driver"))

    def driver_input(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> DriverInput:
        """Acceleration (m/s²) and steering angle (rad) that a control means at a state.

        Raises:
            ValueError: The model does not say what its controls are to a driver, as by default.
        """
        raise ValueError(self._no_driver("driver_input"))

    def wheel_forces(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> WheelForces | None:
        """What happens at the wheels; None, the default, for a model without wheels."""
        return None

    def derived_quantities(self) -> Mapping[str, DerivedQuantity]:
        """Combinations of parameters that steer the model, by name; none by default.

        A track may inform them where it does not inform the single parameters.
        """
        return {}

    def description(self) -> dict[str, Any]:
        """What a results file tells of the model; a model adds what its class does not tell."""
        return {
            "class": type(self).__name__,
            "tyre_law": None,
            "step_s": self.dt_s,
            "substeps": 1,
        }

    def select(self, index: Int[Tensor, " k"]) -> Self:
        """The model for the problems `index` of a batch: itself, as all share its parameters."""
        return self

    def _fitting(
        self, state: Float[Tensor, "*#b n"], control: Float[Tensor, "*#b m"]
    ) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b m"]]:
        """State and control of one batch, each with the columns of the model."""
        self._require_states("state", state)
        require_columns("control", control, self.control_dim, self.Control._fields)
        batch, other = state.shape[:-1], control.shape[:-1]
        if batch == other:
            return state, control
        fits = all(a == b or 1 in (a, b) for a, b in zip(batch[::-1], other[::-1], strict=False))
        needs = f"have leading dimensions that fit those of the state, {tuple(batch)}"
        require(fits, "control", needs, f"shape {tuple(control.shape)}")
        shape = torch.broadcast_shapes(batch, other)
        return state.expand(*shape, -1), control.expand(*shape, -1)

    def _require_states(self, argument: str, states: Tensor) -> None:
        """Refuse states of another model, in whose columns stands something else."""
        require_columns(argument, states, self.state_dim, self.State._fields)

    def _no_driver(self, method: str) -> str:
        remedy = f"Write `{method}` for it."
        return message("dynamics", "be steered by an angle", type(self).__name__, "", remedy)

    def within_bounds(self, control: Float[Tensor, "*b m"]) -> Float[Tensor, "*b m"]:
        """Clip controls to the box."""
        return torch.minimum(torch.maximum(control, self.bounds.lower), self.bounds.upper)

    def physical_parameters(self) -> dict[str, Tensor]:
        """Values of all physical parameters in physical units by their names, learned or frozen.

        Of shape (), or one entry per wheel. Empty for a model without any, such as a baseline that
        only follows tracks.
        """
        return {
            name: module()
            for name, module in self.named_modules()
            if isinstance(module, SoftClamped)
        }
