"""Zero-order hold: a dynamics model with longer control steps, seen from the robot's centre."""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.dynamics import (
    AccelerationRange,
    DerivedQuantity,
    DriverInput,
    DynamicsModel,
    WheelForces,
)
from diffstack_mmv.geometry import direction
from diffstack_mmv.simulation.governor import Governor
from diffstack_mmv.types import Motion


class ZeroOrderHold(DynamicsModel):
    """The same model with a longer control step, x⁺ = f(f(... f(x, u), u), u), and another point.

    A plan over 3 s needs few controls, and a kinematic model with one Euler step small steps. The
    motion is that of a point on the axis of the body ahead of the model's own reference point, so
    that models with different reference points (rear axle, centre of gravity) talk of one robot.

    Args:
        model: The model, whose parameters stay shared.
        repeats: Steps of the model per control.
        ahead_m: Distance of the point ahead of the model's reference point.
        speed_max_mps: Top speed to which the drive of the vehicle is governed, ahead and backwards;
            none where the model keeps it, or there is none.

    Raises:
        ValueError: There is not at least one step, or the top speed does not fit the model.
    """

    def __init__(
        self,
        model: DynamicsModel,
        repeats: int,
        ahead_m: float = 0.0,
        speed_max_mps: float | None = None,
    ) -> None:
        require_at_least("repeats", repeats, 1)
        for record in ("State", "Control"):
            setattr(self, record, getattr(model, record))
        super().__init__(model.dt_s * repeats, model.control_lower, model.control_upper)
        self.model = model
        # in a tuple it is no part of its own, with the parameters a second time
        self._lengthened = (model.lengthened(repeats),)
        self.repeats = repeats
        self.ahead_m = ahead_m
        self.governor = None if speed_max_mps is None else Governor(model, speed_max_mps)

    def step(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b n"]:
        """Advance by one control step."""
        for _ in range(self.repeats):
            acting = control if self.governor is None else self.governor(state, control)
            state = self.model.step(state, acting)
        return state

    def motion(self, states: Float[Tensor, "*b n"], controls: Float[Tensor, "*b m"]) -> Motion:
        """Motion of the point in m, rad, m/s."""
        return _moved(self.model.motion(states, controls), self.ahead_m)

    def initial_state(self, motion: Motion) -> Float[Tensor, "*b n"]:
        """State of the model whose point moves like this (m, rad, m/s)."""
        return self.model.initial_state(_moved(motion, -self.ahead_m))

    def state_on_course(self, motion: Motion) -> Float[Tensor, "*b n"]:
        """State of the model on this course; the lateral motion of the point is left out."""
        return self.model.state_on_course(_moved(motion, -self.ahead_m))

    def control_for(
        self,
        state: Float[Tensor, "*#b n"],
        acceleration: Float[Tensor, "*#b"],
        curvature: Float[Tensor, "*#b"],
    ) -> Float[Tensor, "*b m"]:
        """Control of the model that holds an acceleration (m/s²) and a curvature (1/m).

        Over the whole hold: a model whose controls say where a step ends is asked for its end.
        """
        return self._whole.control_for(state, acceleration, curvature)

    def curvature_within_grip(
        self,
        state: Float[Tensor, "*b n"],
        acceleration: Float[Tensor, "*b"],
        curvature: Float[Tensor, "*b"],
    ) -> Float[Tensor, "*b"]:
        """What of a curvature (1/m) the tyres hold beside an acceleration (m/s²)."""
        return self.model.curvature_within_grip(state, acceleration, curvature)

    @property
    def reference_ahead_m(self) -> float:
        """Distance in m of the point ahead of the centre of gravity."""
        return self.model.reference_ahead_m + self.ahead_m

    @property
    def longest_step_s(self) -> float:
        """Longest step in s of the model itself, not of the hold."""
        return self.model.longest_step_s

    @property
    def moves_with_pose(self) -> bool:
        """Whether a moved and turned vehicle does the same, moved and turned."""
        return self.model.moves_with_pose

    @property
    def keeps_top_speed(self) -> bool:
        """Whether the model, or the governor of its drive, keeps the top speed."""
        return self.governor is not None or self.model.keeps_top_speed

    @property
    def can_reverse(self) -> bool:
        """Whether the vehicle drives backwards where it brakes on."""
        return self.model.can_reverse

    def useful_acceleration(self, state: Float[Tensor, "*b n"]) -> AccelerationRange | None:
        """Accelerations in m/s² that reach an end of the speeds at the end of the hold, no sooner.

        The ends are those of the model and of its governor.
        """
        own = self._whole.useful_acceleration(state)
        if self.governor is None:
            return own
        governed = self.governor.range(state, self.dt_s)
        return governed if own is None else own.within(governed)

    @property
    def driver_input_needs_state(self) -> bool:
        """Whether what a control of the model means depends on the state."""
        return self.model.driver_input_needs_state

    def control_for_driver(
        self, state: Float[Tensor, "*b n"], driver: DriverInput
    ) -> Float[Tensor, "*b m"]:
        """Control of the model that is an acceleration (m/s²) and a steering angle (rad)."""
        return self._whole.control_for_driver(state, driver)

    def driver_input(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> DriverInput:
        """What a control of the model means to a driver, m/s² and rad."""
        return self._whole.driver_input(state, control)

    def wheel_forces(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> WheelForces | None:
        """What happens at the wheels of the model, SI units."""
        return self.model.wheel_forces(state, control)

    def derived_quantities(self) -> Mapping[str, DerivedQuantity]:
        """Combinations of the model's parameters."""
        return self.model.derived_quantities()

    def description(self) -> dict[str, Any]:
        """The model itself, with its own step."""
        return self.model.description()

    @property
    def _whole(self) -> DynamicsModel:
        """The model with the hold as its step."""
        return self._lengthened[0]


def _moved(motion: Motion, ahead_m: float) -> Motion:
    """Motion of the point of the same body that lies `ahead_m` ahead."""
    if ahead_m == 0:
        return motion
    lateral = motion.velocity[..., 1] + ahead_m * motion.yaw_rate
    return motion._replace(
        position=motion.position + ahead_m * direction(motion.heading),
        velocity=torch.stack([motion.velocity[..., 0], lateral], -1),
    )
