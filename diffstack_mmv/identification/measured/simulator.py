"""Positions of the antenna from measured steering and speed, with derivatives for all unknowns."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import functional_call, jvp, vmap

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.dynamics.records import DriverInput
from diffstack_mmv.geometry import direction
from diffstack_mmv.identification.measured.instruments import GRAVITY, MeasurementNoise
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.shooting import ParameterVector
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import VehicleSpec, turning_axle_m

POSE, RECORDING, COASTING, INSTALLED = 3, 4, 2, 3
"""Numbers of unknowns: pose at the start, of a recording, freewheel, antenna and gain of the
encoder."""

SMALL = 1e-3
"""Curvature in 1/m at which the steering per curvature is taken."""

ENGAGING_MPS = 0.04
"""Width of the smooth maximum of the speeds of wheel and coasting vehicle."""


class Simulated(NamedTuple):
    """What a model makes of the measured controls."""

    position: Float[Tensor, "w T1 2"]  # m, of the antenna
    yaw_rate: Float[Tensor, "w T"]  # rad/s, mean of each step
    states: Float[Tensor, "w T1 n"]


class Linearised(NamedTuple):
    """Outputs (positions, then yaw rates) with their derivatives."""

    outputs: Float[Tensor, "w o"]
    shared: Float[Tensor, "w o s"]  # by θ of the vehicle and the place of the antenna
    local: Float[Tensor, "w o l"]  # by the unknowns of recording and window


class _SteerPerCurvature(torch.nn.Module):
    """Steering angle that a model needs for a small curvature, in m: a wheelbase and more."""

    def __init__(self, model: DynamicsModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, state: Float[Tensor, "w n"]) -> Float[Tensor, " w"]:
        """At states."""
        small = torch.full_like(state[:, 0], SMALL)
        control = self.model.control_for(state, torch.zeros_like(small), small)
        return self.model.driver_input(state, control).steer / SMALL


class _Stepper(torch.nn.Module):
    """A model driven by speed and steering, as one module for a functional call."""

    def __init__(self, model: DynamicsModel, wheelbase_m: float) -> None:
        super().__init__()
        self.model, self.wheelbase_m = model, wheelbase_m

    def per_curvature(self, state: Float[Tensor, "w n"]) -> Float[Tensor, " w"]:
        """Steering angle per curvature at states, m."""
        return _SteerPerCurvature(self.model)(state)

    def forward(
        self, start: Tensor, speed: Tensor, steer: Tensor, bend: Tensor
    ) -> tuple[Tensor, Tensor]:
        """States and headings from a start (x, y, course), speeds (w T1), angles and bends (w T).

        A bend is a path curvature in 1/m that the steering does not explain.
        """
        model = self.model
        turn = speed[:, 0] * steer[:, 0].tan() / self.wheelbase_m
        velocity = torch.stack([speed[:, 0], torch.zeros_like(turn)], -1)
        states = [model.state_on_course(Motion(start[:, :2], start[:, 2], velocity, turn))]
        idle = states[0].new_zeros(*steer.shape[:1], model.control_dim)
        forward = model.motion(states[0], idle).velocity[..., 0]
        steer = steer + self.per_curvature(states[0]).unsqueeze(-1) * bend
        for step in range(steer.shape[-1]):
            driver = DriverInput((speed[:, step + 1] - forward) / model.dt_s, steer[:, step])
            states.append(model.step(states[-1], model.control_for_driver(states[-1], driver)))
            forward = model.motion(states[-1], idle).velocity[..., 0]
        path = torch.stack(states, 1)
        return path, model.motion(path, idle.unsqueeze(1).expand(-1, path.shape[1], -1)).heading


def freewheeling(
    wheel: Float[Tensor, "w T1"], excess: Float[Tensor, " w"], loss: Float[Tensor, " w"]
) -> Float[Tensor, "w T1"]:
    """Speed of a vehicle that its wheel can push but not hold: max(wheel, start + excess - loss t).

    The maximum is smooth. That a wheel may be outrun again within a window is neglected.

    Args:
        wheel: Speed of the driven wheel, m/s.
        excess: Of the vehicle over the wheel at the start, m/s.
        loss: Of speed in a step while coasting, m/s.
    """
    steps = torch.arange(wheel.shape[-1], dtype=wheel.dtype)
    coasting = wheel[:, :1] + excess.unsqueeze(-1) - loss.unsqueeze(-1) * steps
    over = (coasting - wheel) / ENGAGING_MPS
    return wheel + ENGAGING_MPS * torch.nn.functional.softplus(over)


def _at_ends(means: Float[Tensor, "w T"]) -> Float[Tensor, "w T1"]:
    """Values at the ends of steps from means over them, straight on at both ends of a window.

    Were the first and the last mean kept instead, the lean would come late at one end and early at
    the other, where positions tell most about it.
    """
    first, last = 2 * means[:, :1] - means[:, 1:2], 2 * means[:, -1:] - means[:, -2:-1]
    ends = torch.cat([first, means, last], -1)
    return 0.5 * (ends[:, 1:] + ends[:, :-1])


class RideSimulator:
    """Simulates windows of rides.

    The unknowns of a window stand in one row: pose of the reference point (m, m, rad), steering
    offset and scale, speed scale, delay, excess and loss of speed of the freewheel, then the errors
    of curvature and speed per knot. Shared
    unknowns are θ of the vehicle, then ahead and height of the antenna in m. The antenna is moved
    sideways by the coordinated lean atan(v r / g).

    Args:
        model: The dynamics, float64.
        parameters: Its learned parameters.
        noise: For the length of the knots.
        spec: The vehicle, for wheelbase and axle.
    """

    def __init__(
        self,
        model: DynamicsModel,
        parameters: ParameterVector,
        noise: MeasurementNoise,
        spec: VehicleSpec,
    ) -> None:
        self.model, self.parameters, self.noise = model, parameters, noise
        self._steering = _SteerPerCurvature(model)
        self._stepper = _Stepper(model, spec.wheelbase.entries()[0][0])
        self._axle_m = turning_axle_m(spec.wheels)

    def knots(self, steps: int) -> int:
        """Number of knots over so many steps, both ends included."""
        return -(-steps // self.noise.knot_steps) + 1

    def local_size(self, steps: int) -> int:
        """Number of unknowns of a window, those of its recording included."""
        return POSE + RECORDING + COASTING + 2 * self.knots(steps)

    def simulate(
        self,
        windows: RideWindows,
        shared: Float[Tensor, " s"] | Float[Tensor, "w s"],
        local: Float[Tensor, "w l"],
    ) -> Simulated:
        """Simulate all windows, of one vehicle or each of its own."""
        columns = (windows.steer, windows.steer_rate, windows.speed)
        if shared.dim() == 1:
            return Simulated(*self._simulated(*columns, shared, local))

        def one(*parts: Tensor) -> tuple[Tensor, ...]:
            *alone, shared, local = parts
            rows = (part.unsqueeze(0) for part in alone)
            found = self._simulated(*rows, shared, local.unsqueeze(0))
            return tuple(part.squeeze(0) for part in found)

        return Simulated(*vmap(one)(*columns, shared, local))

    def _simulated(
        self, steer: Tensor, steer_rate: Tensor, speed: Tensor, shared: Tensor, local: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Positions of the antenna, yaw rates and states under one vehicle."""
        theta, (ahead, height, gain) = shared[:-INSTALLED], shared[-INSTALLED:].unbind()
        driven = self._driven(steer, steer_rate, speed, local, gain)
        speed = driven[0]
        weights = self.parameters.tensors(theta, "model.")
        start = local[:, :POSE]
        states, heading = functional_call(self._stepper, weights, (start, *driven))
        yaw_rate = heading.diff(dim=-1) / self.model.dt_s
        aside = height * torch.atan(_at_ends(yaw_rate) * speed / GRAVITY)
        ahead = ahead - self.model.reference_ahead_m + self._axle_m
        along = direction(heading)
        across = torch.stack([-along[..., 1], along[..., 0]], -1)
        idle = states.new_zeros(*states.shape[:-1], self.model.control_dim)
        place = self.model.motion(states, idle).position
        return place + ahead * along + aside.unsqueeze(-1) * across, yaw_rate, states

    def steer_per_curvature(
        self, shared: Float[Tensor, " s"], speed_mps: float = 3.0
    ) -> Float[Tensor, ""]:
        """Measured steering angle per path curvature in m: what wheelbase, tyres and encoder do."""
        weights = self.parameters.tensors(shared[:-INSTALLED], "model.")
        pose, speed = shared.new_zeros(1, POSE), shared.new_full((1, 1), speed_mps)
        way = Motion(pose[:, :2], pose[:, 2], torch.cat([speed, 0 * speed], -1), 0 * pose[:, 2])
        state = self.model.state_on_course(way)
        return functional_call(self._steering, weights, (state,)).squeeze(0) / shared[-1]

    def linearise(
        self,
        windows: RideWindows,
        shared: Float[Tensor, " s"] | Float[Tensor, "w s"],
        local: Float[Tensor, "w l"],
        by_shared: bool = True,
    ) -> Linearised:
        """Outputs and derivatives; each direction is taken for all windows at once.

        Without `by_shared` the derivatives by the shared unknowns are left out (s = 0).
        """

        def outputs(shared: Tensor, local: Tensor) -> Tensor:
            found = self.simulate(windows, shared, local)
            return torch.cat([found.position.flatten(1), found.yaw_rate], -1)

        def along(shared_way: Tensor, local_way: Tensor) -> tuple[Tensor, Tensor]:
            ways = shared_way.expand_as(shared), local_way.expand_as(local)
            value, slope, *_ = jvp(outputs, (shared, local), ways)
            return value, slope

        count, size = shared.shape[-1], shared.shape[-1] + local.shape[-1]
        ways = torch.eye(size, dtype=local.dtype)
        # the types of torch know no output that is not mapped
        every = vmap(along, out_dims=(None, -1))  # pyright: ignore[reportArgumentType]
        if not by_shared:
            value, slope = every(ways[count:, :count], ways[count:, count:])
            return Linearised(value, slope[..., :0], slope)
        value, slope = every(ways[:, :count], ways[:, count:])
        return Linearised(value, slope[..., :count], slope[..., count:])

    def _driven(
        self,
        steer: Float[Tensor, "w T"],
        steer_rate: Float[Tensor, "w T"],
        speed: Float[Tensor, "w T1"],
        local: Float[Tensor, "w l"],
        gain: Float[Tensor, ""],
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Speed (w T1), steering and bend (w T) after the corrections of a window."""
        steps = steer.shape[-1]
        count = self.knots(steps)
        offset, scale, pace, delay = local[:, POSE : POSE + RECORDING].T.unsqueeze(-1)
        excess, loss = local[:, POSE + RECORDING :][:, :COASTING].T
        errors = local[:, POSE + RECORDING + COASTING :]
        steer = gain * scale * (steer - delay * steer_rate) + offset
        ends = torch.arange(steps + 1, dtype=errors.dtype)
        bend = self._between(errors[:, :count], ends[:-1] + 0.5)
        wheel = speed * (pace + self._between(errors[:, count:], ends))
        return freewheeling(wheel, excess, loss * self.model.dt_s), steer, bend

    def _between(
        self, knots: Float[Tensor, "w k"], steps: Float[Tensor, " t"]
    ) -> Float[Tensor, "w t"]:
        """Values between knots by straight lines: jumps of the speed would saturate the model."""
        place = steps / self.noise.knot_steps
        left = place.floor().long().clamp(max=knots.shape[-1] - 2)
        share = place - left
        return (1 - share) * knots[:, left] + share * knots[:, left + 1]
