"""What a vehicle does in a window, piece by piece: it begins, goes on, and is seen."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.dynamics.records import DriverInput
from diffstack_mmv.geometry import direction
from diffstack_mmv.types import GRAVITY, Motion

SMALL = 1e-3
"""Curvature in 1/m at which the steering per curvature is taken."""


def steer_per_curvature(model: DynamicsModel, state: Float[Tensor, "*b n"]) -> Float[Tensor, "*b"]:
    """Steering angle that a model needs for a small curvature, in m: a wheelbase and more."""
    small = torch.full_like(state[..., 0], SMALL)
    control = model.control_for(state, torch.zeros_like(small), small)
    return model.driver_input(state, control).steer / SMALL


class SteerPerCurvature(torch.nn.Module):
    """`steer_per_curvature` at states."""

    def __init__(self, model: DynamicsModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, state: Float[Tensor, "*b n"]) -> Float[Tensor, "*b"]:
        """In m."""
        return steer_per_curvature(self.model, state)


class Beginning(torch.nn.Module):
    """State at the start of windows, and the steering of a whole window."""

    def __init__(self, model: DynamicsModel, wheelbase_m: float) -> None:
        super().__init__()
        self.model, self.wheelbase_m = model, wheelbase_m

    def forward(
        self,
        pose: Float[Tensor, "*b 3"],
        speed: Float[Tensor, "*b T1"],
        steer: Float[Tensor, "*b T"],
        bend: Float[Tensor, "*b T"],
    ) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b T"]]:
        """From a pose (x, y, course), speeds, angles and bends.

        A bend is a path curvature in 1/m that the steering does not explain.
        """
        turn = speed[..., 0] * steer[..., 0].tan() / self.wheelbase_m
        velocity = torch.stack([speed[..., 0], torch.zeros_like(turn)], -1)
        state = self.model.state_on_course(Motion(pose[..., :2], pose[..., 2], velocity, turn))
        return state, steer + steer_per_curvature(self.model, state).unsqueeze(-1) * bend


class Step(torch.nn.Module):
    """A step of a model that is driven by speed and steering."""

    def __init__(self, model: DynamicsModel) -> None:
        super().__init__()
        self.model = model

    def forward(
        self, state: Float[Tensor, "*b n"], speed: Float[Tensor, "*b"], steer: Float[Tensor, "*b"]
    ) -> Float[Tensor, "*b n"]:
        """State after a step that ends at a speed, under an angle."""
        model = self.model
        idle = state.new_zeros(*state.shape[:-1], model.control_dim)
        forward = model.motion(state, idle).velocity[..., 0]
        driver = DriverInput((speed - forward) / model.dt_s, steer)
        return model.step(state, model.control_for_driver(state, driver))


class Antenna(torch.nn.Module):
    """Where the antenna is, and how fast the vehicle turns.

    The antenna is moved sideways by the coordinated lean atan(v r / g).

    Args:
        model: The dynamics.
        axle_m: Longitudinal position of the axle that the antenna is measured from, m.
        lead_s: By what time of travel a vehicle is ahead of its states, s.
    """

    def __init__(self, model: DynamicsModel, axle_m: float, lead_s: float) -> None:
        super().__init__()
        self.model, self.axle_m, self.lead_s = model, axle_m, lead_s

    def forward(
        self,
        states: Float[Tensor, "*b T1 n"],
        speed: Float[Tensor, "*b T1"],
        installed: Float[Tensor, " 2"],
    ) -> tuple[Float[Tensor, "*b T1 2"], Float[Tensor, "*b T"]]:
        """Positions in m, mean yaw rates in rad/s; `installed`: ahead of the axle, height in m."""
        model = self.model
        ahead, height = installed.unbind()
        idle = states.new_zeros(*states.shape[:-1], model.control_dim)
        seen = model.motion(states, idle)
        yaw_rate = seen.heading.diff(dim=-1) / model.dt_s
        aside = height * torch.atan(at_ends(yaw_rate) * speed / GRAVITY)
        ahead = ahead - model.reference_ahead_m + self.axle_m + self.lead_s * speed
        along = direction(seen.heading)
        across = torch.stack([-along[..., 1], along[..., 0]], -1)
        place = seen.position + ahead.unsqueeze(-1) * along
        return place + aside.unsqueeze(-1) * across, yaw_rate


def at_ends(means: Float[Tensor, "*b T"]) -> Float[Tensor, "*b T1"]:
    """Values at the ends of steps from means over them, straight on at both ends of a window.

    Were the first and the last mean kept instead, the lean would come late at one end and early at
    the other, where positions tell most about it.
    """
    first, last = 2 * means[..., :1] - means[..., 1:2], 2 * means[..., -1:] - means[..., -2:-1]
    ends = torch.cat([first, means, last], -1)
    return 0.5 * (ends[..., 1:] + ends[..., :-1])
