"""Positions of the antenna from measured steering and speed, with derivatives for all unknowns."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import functional_call, jvp, vmap

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.measured.instruments import (
    INSTALLED_NAMES,
    OF_FREEWHEEL,
    OF_RECORDING,
    MeasurementNoise,
)
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.vehicle import (
    Antenna,
    Beginning,
    SteerPerCurvature,
    Step,
)
from diffstack_mmv.identification.shooting import ParameterVector
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import VehicleSpec, turning_axle_m

POSE, RECORDING, COASTING, INSTALLED = 3, len(OF_RECORDING), len(OF_FREEWHEEL), len(INSTALLED_NAMES)
"""Numbers of unknowns: pose at the start, recording, freewheel, antenna and gain of the encoder."""

ENGAGING_MPS = 0.04
"""Width of the smooth maximum of the speeds of wheel and coasting vehicle."""


class Simulated(NamedTuple):
    """What a model makes of the measured controls."""

    position: Float[Tensor, "w T1 2"]  # m, of the antenna
    yaw_rate: Float[Tensor, "w T"]  # rad/s, mean of each step
    states: Float[Tensor, "w T1 n"]
    speed: Float[Tensor, "w T1"]  # m/s, corrected
    steer: Float[Tensor, "w T"]  # rad, corrected


class StepSlopes(NamedTuple):
    """Derivatives of the states after each step, d directions."""

    state: Float[Tensor, "w T n n"]
    speed: Float[Tensor, "w T n"]  # at the end of the step
    steer: Float[Tensor, "w T n"]
    shared: Float[Tensor, "w T n d"]


class Linearised(NamedTuple):
    """Outputs (positions, then yaw rates) with their derivatives."""

    outputs: Float[Tensor, "w o"]
    shared: Float[Tensor, "w o s"]  # by θ of the vehicle and the place of the antenna
    local: Float[Tensor, "w o l"]  # by the unknowns of recording and window


def freewheeling(
    wheel: Float[Tensor, "*b T1"], excess: Float[Tensor, "*b"], loss: Float[Tensor, "*b"]
) -> Float[Tensor, "*b T1"]:
    """Speed of a vehicle that its wheel can push but not hold: max(wheel, start + excess - loss t).

    The maximum is smooth. That a wheel may be outrun again within a window is neglected.

    Args:
        wheel: Speed of the driven wheel, m/s.
        excess: Of the vehicle over the wheel at the start, m/s.
        loss: Of speed in a step while coasting, m/s.
    """
    steps = torch.arange(wheel.shape[-1], dtype=wheel.dtype)
    coasting = wheel[..., :1] + excess.unsqueeze(-1) - loss.unsqueeze(-1) * steps
    over = (coasting - wheel) / ENGAGING_MPS
    return wheel + ENGAGING_MPS * torch.nn.functional.softplus(over)


class RideSimulator:
    """Simulates windows of rides.

    The unknowns of a window stand in one row: pose of the reference point (m, m, rad), steering
    offset and scale, speed scale, delay, excess and loss of speed of the freewheel, then the errors
    of curvature and speed per knot. Shared unknowns are θ of the vehicle, then ahead and height of
    the antenna in m. The antenna is moved sideways by the coordinated lean atan(v r / g).

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
        self._steering, self._step = SteerPerCurvature(model), Step(model)
        self._beginning = Beginning(model, spec.wheelbase.entries()[0][0])
        self._antenna = Antenna(model, turning_axle_m(spec.wheels), self.lead_s)
        self.spec = spec

    @property
    def lead_s(self) -> float:
        """By what time of travel a vehicle is ahead of its states, s.

        Half a step for a model that `acts_a_step_late`. Its way is the sum of speed and course at
        the starts of the steps; half a step more at the end, and less at the start, makes it
        that of the trapezoidal rule.
        """
        return 0.5 * self.model.dt_s if self.model.acts_a_step_late else 0.0

    def under(self, noise: MeasurementNoise) -> "RideSimulator":
        """The same vehicle under another noise."""
        return RideSimulator(self.model, self.parameters, noise, self.spec)

    def knots(self, steps: int) -> int:
        """Number of knots over so many steps, both ends included."""
        return -(-steps // self.noise.knot_steps) + 1

    def simulate(
        self,
        windows: RideWindows,
        shared: Float[Tensor, " s"] | Float[Tensor, "w s"],
        local: Float[Tensor, "w l"],
    ) -> Simulated:
        """Simulate all windows, of one vehicle or each of its own."""
        state, steer, speed = self._begun(windows, shared, local)
        states = [state]
        for now, after in zip(steer.unbind(-1), speed.unbind(-1)[1:], strict=True):
            states.append(_of_each(self._stepped, shared, states[-1], after, now))
        path = torch.stack(states, -2)
        position, yaw_rate = _of_each(self._seen, shared, path, speed)
        return Simulated(position, yaw_rate, path, speed, steer)

    def _begun(
        self, windows: RideWindows, shared: Tensor, local: Float[Tensor, "w l"]
    ) -> tuple[Tensor, ...]:
        """State at the start (w n), angles (w T) and speeds (w T1)."""
        columns = windows.steer, windows.steer_rate, windows.speed
        return _of_each(self._driven_start, shared, local, *columns)

    def _driven_start(
        self, shared: Tensor, local: Tensor, steer: Tensor, steer_rate: Tensor, speed: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        driven = self._driven(steer, steer_rate, speed, local, shared[-1])
        start = local[..., :POSE], *driven
        state, steer = functional_call(self._beginning, self._weights(shared), start)
        return state, steer, driven[0]

    def _stepped(self, shared: Tensor, state: Tensor, speed: Tensor, steer: Tensor) -> Tensor:
        return functional_call(self._step, self._weights(shared), (state, speed, steer))

    def _seen(self, shared: Tensor, states: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        place = shared[-INSTALLED:-1]
        return functional_call(self._antenna, self._weights(shared), (states, speed, place))

    def _weights(self, shared: Float[Tensor, " s"]) -> dict[str, Tensor]:
        return self.parameters.tensors(shared[:-INSTALLED], "model.")

    def steer_per_curvature(
        self, shared: Float[Tensor, " s"], speed_mps: float = 3.0
    ) -> Float[Tensor, ""]:
        """Measured steering angle per path curvature in m: what wheelbase, tyres and encoder do."""
        weights = self._weights(shared)
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
        """Outputs and derivatives.

        The derivatives of all steps are taken at once, at the states of a simulation, and chained:
        to push every direction through the simulation would take as many operations per step.
        Without `by_shared` the derivatives by the shared unknowns are left out (s = 0).
        """
        found = self.simulate(windows, shared, local)
        count = shared.shape[-1]
        first = 0 if by_shared else count
        ways = torch.eye(count + local.shape[-1], dtype=local.dtype)[first:]
        by, own = ways[:, :count], ways[:, count:]
        state, steer, speed = _slopes(partial(self._begun, windows), (shared, local), (by, own))
        path = _chained(self._step_slopes(found, shared, by), state, speed, steer)
        seen = partial(_of_each, self._seen)
        moved = by, path.movedim(-1, 0), speed.movedim(-1, 0)
        place, yaw_rate = _slopes(seen, (shared, found.states, found.speed), moved)
        slope = torch.cat([place.flatten(1, 2), yaw_rate], 1)
        value = torch.cat([found.position.flatten(1), found.yaw_rate], -1)
        return Linearised(value, slope[..., : count - first], slope[..., count - first :])

    def _step_slopes(
        self, found: Simulated, shared: Tensor, by: Float[Tensor, "d s"]
    ) -> StepSlopes:
        """Derivatives of every step by what goes into it."""
        size = found.states.shape[-1]
        step = partial(_of_each, self._stepped)
        at = shared, found.states[:, :-1], found.speed[:, 1:], found.steer
        ways = torch.eye(size + 2, dtype=found.states.dtype)
        idle = ways.new_zeros(size + 2, by.shape[-1])
        (slopes,) = _slopes(step, at, (idle, ways[:, :size], ways[:, -2], ways[:, -1]))
        parts = slopes[..., :size], slopes[..., -2], slopes[..., -1]
        if not bool(by.any()):
            return StepSlopes(*parts, slopes.new_zeros(*slopes.shape[:-1], len(by)))
        still = ways.new_zeros(len(by), size)
        (of_vehicle,) = _slopes(step, at, (by, still, still[:, 0], still[:, 0]))
        return StepSlopes(*parts, of_vehicle)

    def _driven(
        self,
        steer: Float[Tensor, "*b T"],
        steer_rate: Float[Tensor, "*b T"],
        speed: Float[Tensor, "*b T1"],
        local: Float[Tensor, "*b l"],
        gain: Float[Tensor, ""],
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Speed (w T1), steering and bend (w T) after the corrections of a window."""
        steps = steer.shape[-1]
        count = self.knots(steps)
        recording = local[..., POSE : POSE + RECORDING].unsqueeze(-2)
        offset, scale, pace, delay = recording.unbind(-1)
        excess, loss = local[..., POSE + RECORDING :][..., :COASTING].unbind(-1)
        errors = local[..., POSE + RECORDING + COASTING :]
        steer = gain * scale * (steer + delay * steer_rate) + offset
        ends = torch.arange(steps + 1, dtype=errors.dtype)
        bend = self._between(errors[..., :count], ends[:-1] + 0.5)
        wheel = speed * (pace + self._between(errors[..., count:], ends))
        return freewheeling(wheel, excess, loss * self.model.dt_s), steer, bend

    def _between(
        self, knots: Float[Tensor, "*b k"], steps: Float[Tensor, " t"]
    ) -> Float[Tensor, "*b t"]:
        """Values between knots by straight lines: jumps of the speed would saturate the model."""
        place = steps / self.noise.knot_steps
        left = place.floor().long().clamp(max=knots.shape[-1] - 2)
        share = place - left
        return (1 - share) * knots[..., left] + share * knots[..., left + 1]


def _of_each(function: Callable[..., Any], shared: Tensor, *rest: Tensor) -> Any:
    """Of windows of one vehicle, or each of its own."""
    return function(shared, *rest) if shared.dim() == 1 else vmap(function)(shared, *rest)


def _slopes(
    function: Callable[..., Any], at: Sequence[Tensor], ways: Sequence[Tensor]
) -> tuple[Tensor, ...]:
    """Derivatives of all outputs along directions, which stand first in `ways` and come last.

    A direction with fewer dimensions than what it changes is the same for all windows.
    """

    def along(*way: Tensor) -> tuple[Tensor, ...]:
        whole = tuple(one.expand_as(value) for one, value in zip(way, at, strict=True))
        _, slope, *_ = jvp(function, tuple(at), whole)
        return slope if isinstance(slope, tuple) else (slope,)

    return vmap(along, out_dims=-1)(*ways)


def _chained(
    slopes: StepSlopes,
    state: Float[Tensor, "w n d"],
    speed: Float[Tensor, "w T1 d"],
    steer: Float[Tensor, "w T d"],
) -> Float[Tensor, "w T1 n d"]:
    """Derivatives of the states from those of single steps."""
    driven = slopes.speed.unsqueeze(-1) * speed[:, 1:].unsqueeze(-2)
    driven = driven + slopes.steer.unsqueeze(-1) * steer.unsqueeze(-2) + slopes.shared
    path = [state]
    for before, push in zip(slopes.state.unbind(1), driven.unbind(1), strict=True):
        path.append(before @ path[-1] + push)
    return torch.stack(path, 1)
