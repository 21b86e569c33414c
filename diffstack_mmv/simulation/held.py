"""A dynamics model as a controller wants it: longer control steps, seen from the robot's centre."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import direction
from diffstack_mmv.types import Motion


class HeldControl(DynamicsModel):
    """The same model with a longer control step, x⁺ = f(f(... f(x, u), u), u), and another point.

    A plan over 3 s needs few controls, and a kinematic model with one Euler step small steps. The
    motion is that of a point on the axis of the body ahead of the model's own reference point, so
    that models with different reference points (rear axle, centre of gravity) talk of one robot.

    Args:
        model: The model, whose parameters stay shared.
        repeats: Steps of the model per control.
        ahead_m: Distance of the point ahead of the model's reference point.

    Raises:
        ValueError: There is not at least one step.
    """

    def __init__(self, model: DynamicsModel, repeats: int, ahead_m: float = 0.0) -> None:
        require_at_least("repeats", repeats, 1)
        for record in ("State", "Control"):
            setattr(self, record, getattr(model, record))
        lower, upper = (bound.tolist() for bound in model.bounds)
        super().__init__(model.dt_s * repeats, lower, upper)
        self.model = model
        self.repeats = repeats
        self.ahead_m = ahead_m

    def step(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b n"]:
        """Advance by one control step."""
        for _ in range(self.repeats):
            state = self.model.step(state, control)
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
        state: Float[Tensor, "*b n"],
        acceleration: Float[Tensor, "*b"],
        curvature: Float[Tensor, "*b"],
    ) -> Float[Tensor, "*b m"]:
        """Control of the model that holds an acceleration (m/s²) and a curvature (1/m)."""
        return self.model.control_for(state, acceleration, curvature)


def _moved(motion: Motion, ahead_m: float) -> Motion:
    """Motion of the point of the same body that lies `ahead_m` ahead."""
    if ahead_m == 0:
        return motion
    lateral = motion.velocity[..., 1] + ahead_m * motion.yaw_rate
    return motion._replace(
        position=motion.position + ahead_m * direction(motion.heading),
        velocity=torch.stack([motion.velocity[..., 0], lateral], -1),
    )
