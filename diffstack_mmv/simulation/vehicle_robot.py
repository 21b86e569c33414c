"""A robot that is a vehicle: its true motion is integrated by a dynamics model in fine steps."""

import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import (
    require,
    require_at_least,
    require_between,
    require_multiple,
    require_positive,
)
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import rotate
from diffstack_mmv.simulation.case_noise import NoiseSource, case_noise
from diffstack_mmv.simulation.collision import DiscFootprint, Footprint
from diffstack_mmv.simulation.governor import Governor
from diffstack_mmv.simulation.robot import Travel
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.verdict import RobotPath
from diffstack_mmv.types import Bounds, Motion

FINEST_NEEDED_S = 0.01
"""A vehicle's true motion is integrated in steps no longer than this."""


class VehicleState(NamedTuple):
    """A vehicle under way."""

    model: Float[Tensor, "*b n"]  # state of the dynamics model
    control: Float[Tensor, "*b m"]  # what acts at present
    pending: Float[Tensor, "*b d m"]  # commanded and not yet acting, one row per fine step
    steps: Int[Tensor, "*b"]  # since the start, which number the draws of the noise
    case: Int[Tensor, "*b"]  # to which the draws belong


@dataclass(frozen=True)
class Actuation:
    """What stands between a command and the vehicle.

    Attributes:
        delay_s: Time until a command acts, a multiple of the model's fine step.
        noise: Standard deviation of the error of each control, constant over a step; empty: none.
        seed: Of the noise; the same seed repeats the same errors.
        speed_max_mps: The drive accelerates no further than to this speed, ahead or backwards,
            where it is given.
        bias: Error of each control that stays, as of a bent steering head; empty: none.

    Raises:
        ValueError: A delay or deviation is negative, or the speed not positive.
    """

    delay_s: float = 0.0
    noise: tuple[float, ...] = ()
    seed: int = 0
    speed_max_mps: float | None = None
    bias: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check the settings once, at the border."""
        require_at_least("delay_s", self.delay_s, 0)
        for deviation in self.noise:
            require_at_least("noise", deviation, 0)
        if self.speed_max_mps is not None:
            require_positive("speed_max_mps", self.speed_max_mps)


class VehicleRobot:
    """A vehicle with its own dynamics; an action is a control of its model.

    The centre of the robot is the reference point of the model, and the footprint lies around it,
    see `vehicle_footprint` for the box of a vehicle. The model is copied, turned to
    float64 and frozen; whatever a controller believes about the vehicle is another model.

    Args:
        model: The true dynamics, whose `dt_s` is the fine step, at most 10 ms.
        actuation: Delay, noise and top speed of the actuators.
        bounds: Box to which actions are clipped; that of the model if None.
        footprint: Outline; the disc of the benchmark if None.

    Raises:
        ValueError: The fine step is too long, or bounds, noise, bias or delay do not fit the model.
    """

    def __init__(
        self,
        model: DynamicsModel,
        actuation: Actuation | None = None,
        bounds: Bounds | None = None,
        footprint: Footprint | None = None,
    ) -> None:
        remedy = "Build the model with a smaller step; a controller may use a longer one."
        require_between("model.dt_s", model.dt_s, 0, FINEST_NEEDED_S + 1e-12, remedy=remedy)
        self.model = copy.deepcopy(model).double().requires_grad_(False)
        self.actuation = actuation or Actuation()
        self.footprint = footprint or DiscFootprint()
        box = bounds or self.model.bounds
        self._bounds = Bounds(box.lower.double(), box.upper.double())
        columns = model.control_dim
        require(len(box.lower) == columns, "bounds", f"have {columns} columns", len(box.lower))
        for name in ("noise", "bias"):
            entries = len(getattr(self.actuation, name))
            require(entries in (0, columns), name, f"have {columns} entries or none", entries)
        self._delay_steps = (
            require_multiple("delay_s", self.actuation.delay_s, model.dt_s, "for the fine step")
            if self.actuation.delay_s > 0
            else 0
        )
        top = self.actuation.speed_max_mps
        self._governor = None if top is None else Governor(self.model, top)

    @property
    def bounds(self) -> Bounds:
        """Box to which actions are clipped, SI units of the model's controls."""
        return self._bounds

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the model's controls."""
        return self.model.Control._fields

    def description(self, dt_s: float) -> dict[str, Any]:
        """The model with its fine step, whatever the step of the world."""
        return self.model.description()

    def start(self, scene: Scene) -> VehicleState:
        """State at rest at the start of a scene (m, rad), nothing commanded yet."""
        resting = torch.zeros_like(scene.robot_heading)
        motion = Motion(
            scene.robot_position,
            scene.robot_heading,
            torch.zeros_like(scene.robot_position),
            resting,
        )
        control = resting[..., None].repeat_interleave(self.model.control_dim, dim=-1)
        pending = control[..., None, :].repeat_interleave(self._delay_steps, dim=-2)
        return VehicleState(
            self.model.initial_state(motion),
            control,
            pending,
            torch.zeros_like(scene.robot_heading, dtype=torch.long),
            scene.case_numbers(),
        )

    def motion(self, state: VehicleState) -> Motion:
        """Motion of the model's reference point in m, rad, m/s."""
        return self.model.motion(state.model, state.control)

    def velocity(self, state: VehicleState) -> Float[Tensor, "*b 2"]:
        """Velocity in m/s in world directions."""
        motion = self.motion(state)
        return rotate(motion.velocity, motion.heading)

    def step(self, state: VehicleState, action: Float[Tensor, "*b m"], dt_s: float) -> Travel:
        """Hold an action for `dt_s` and integrate the true dynamics in fine steps.

        Args:
            state: State at the start of the step.
            action: Control in the units of the model.
            dt_s: Length of the step, a multiple of the model's fine step.

        Returns:
            State at the end, and the path with one point per fine step.

        Raises:
            ValueError: The step is no multiple of the fine step.
        """
        pieces = require_multiple("dt_s", dt_s, self.model.dt_s, "for the model's fine step")
        command = self._disturbed(action.to(state.model), state)
        queue = torch.cat(
            (state.pending, command[..., None, :].repeat_interleave(pieces, dim=-2)), dim=-2
        )
        models, controls = [state.model], []
        for piece in range(pieces):
            controls.append(self._governed(models[-1], queue[..., piece, :]))
            models.append(self.model(models[-1], controls[-1]))
        after = VehicleState(
            models[-1], controls[-1], queue[..., pieces:, :], state.steps + 1, state.case
        )
        motion = self.model.motion(
            torch.stack(models, dim=-2), torch.stack((state.control, *controls), dim=-2)
        )
        path = RobotPath(motion.position, motion.heading)
        moved = motion.position[..., -1, :] - motion.position[..., 0, :]
        return Travel(after, moved / dt_s, path)

    def _disturbed(
        self, action: Float[Tensor, "*b m"], state: VehicleState
    ) -> Float[Tensor, "*b m"]:
        """What arrives at the actuators: the action with its error, within the bounds."""
        if self.actuation.noise:
            seed, columns = self.actuation.seed, action.shape[-1:]
            error = case_noise(NoiseSource.ACTUATORS, state.case, state.steps, columns, seed)
            action = action + error.to(action) * action.new_tensor(self.actuation.noise)
        if self.actuation.bias:
            action = action + action.new_tensor(self.actuation.bias)
        return torch.minimum(torch.maximum(action, self._bounds.lower), self._bounds.upper)

    def _governed(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b m"]:
        """What the drive makes of a command in a state of the model."""
        return control if self._governor is None else self._governor(state, control)
