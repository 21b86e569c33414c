"""A vehicle that does not know its own motion: measured on board, estimated, and driven by that."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import rotate
from diffstack_mmv.simulation.case_noise import NoiseSource, case_noise, milliseconds
from diffstack_mmv.simulation.decisions import (
    Controller,
    Decided,
    batched,
    diagnosis_of,
    thoughts_of,
    unbatched,
)
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.types import EgoEstimate, EgoMeasurement, Motion, map_tensors


@runtime_checkable
class EgoUpdated(Protocol):
    """An estimate, and what is remembered for the next."""

    @property
    def estimate(self) -> EgoEstimate:
        """The vehicle now."""
        ...

    @property
    def horizon(self) -> Any:
        """The estimator's own record."""
        ...


@runtime_checkable
class EgoStateEstimator(Protocol):
    """Tells the motion of a vehicle from what it has measured so far."""

    def init(self, measurement: EgoMeasurement, course: Float[Tensor, " b"] | None = None) -> Any:
        """What is remembered after a first measurement, with the course (rad) where it is known."""
        ...

    def __call__(self, horizon: Any, measurement: EgoMeasurement) -> EgoUpdated:
        """Take a measurement in."""
        ...


@dataclass(frozen=True)
class EgoInstruments:
    """What is on board: a receiver of positions, a wheel encoder, a servo and perhaps a gyro.

    Attributes:
        position_m: Standard deviation of a measured coordinate.
        speed_mps: Standard deviation of the measured speed.
        yaw_rate_radps: Standard deviation of the gyro; no gyro if None.
        seed: Of the errors; the same seed repeats the same errors.

    Raises:
        ValueError: A deviation is negative.
    """

    position_m: float = 0.02
    speed_mps: float = 0.02
    yaw_rate_radps: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("position_m", "speed_mps"):
            require_at_least(name, getattr(self, name), 0)
        if self.yaw_rate_radps is not None:
            require_at_least("yaw_rate_radps", self.yaw_rate_radps, 0)

    def __call__(
        self,
        before: Motion,
        now: Motion,
        steer: Float[Tensor, " b"],
        case: Int[Tensor, " b"],
        time: Float[Tensor, " b"],
    ) -> EgoMeasurement:
        """What is measured at the end of a step, and on average in it.

        Args:
            before: True motion at the start of the step, `b`.
            now: True motion at its end.
            steer: Angle that the servo reports in rad.
            case: Numbers of the cases, to which the errors belong.
            time: Time of the end in s, which tells the errors of a case apart.
        """
        error = case_noise(NoiseSource.EGO, case, milliseconds(time), (4,), self.seed)
        turned = 0.5 * (before.yaw_rate + now.yaw_rate).double()
        gyro = torch.nan if self.yaw_rate_radps is None else self.yaw_rate_radps
        speed = 0.5 * (before.velocity[:, 0] + now.velocity[:, 0]).double()
        return EgoMeasurement(
            position=now.position.double() + self.position_m * error[:, :2],
            known=torch.ones(len(steer), dtype=torch.bool),
            steer=steer.double(),
            speed=speed + self.speed_mps * error[:, 2],
            yaw_rate=turned + gyro * error[:, 3],
        )


class EstimatingState(NamedTuple):
    """What an estimating controller remembers."""

    horizon: Any
    before: Motion
    commanded: Float[Tensor, "b m"]  # the last action
    instruments: Float[Tensor, "b 4"] | None  # estimated last
    inner: Any


class EstimatingController:
    """Another controller that is told its motion by an estimator, and whose steering is corrected.

    The servo reports the angle it was commanded. The wheel stands elsewhere where head or linkage
    are bent, which the estimator finds in the path: commands are chosen so that the wheel stands
    where the controller wants it. The true motion goes into the instruments and nowhere else, but
    for where the vehicle points before it starts.

    Args:
        controller: Decides.
        estimator: Of the vehicle's motion.
        instruments: What is measured.
        model: Of the robot, for what its actions mean to the steering.

    Raises:
        ValueError: The actions of the model tell no steering angle.
    """

    def __init__(
        self,
        controller: Controller,
        estimator: EgoStateEstimator,
        instruments: EgoInstruments,
        model: DynamicsModel,
    ) -> None:
        angles, remedy = not model.driver_input_needs_state, "Take a model with a steering angle."
        require(angles, "model", "be driven by a steering angle", type(model).__name__, "", remedy)
        self.controller = controller
        self.estimator = estimator
        self.instruments = instruments
        self.model = model

    def init(self, observation: Observation) -> EstimatingState:
        """Nothing has been measured yet."""
        observation = batched(observation)
        motion, like = observation.motion, self.model.bounds.lower
        still = like.new_zeros(len(motion.heading), self.model.control_dim)
        return EstimatingState(None, motion, still, None, self.controller.init(observation))

    def act(self, state: EstimatingState, observation: Observation) -> Decided:
        """What the other controller decides, as a command that leads to it."""
        if observation.time.dim() == 0:
            return unbatched(self, state, observation)
        seen = observation.motion
        steer = self.model.driver_input(self._unmoved(state.commanded), state.commanded).steer
        measured = self.instruments(state.before, seen, steer, observation.case, observation.time)
        horizon, instruments, believed = state.horizon, state.instruments, seen
        if horizon is None:
            horizon = self.estimator.init(measured, seen.heading)
            believed = seen._replace(position=measured.position.to(seen.position))
        else:
            found = self.estimator(horizon, measured)
            horizon, instruments = found.horizon, found.estimate.instruments
            believed = map_tensors(lambda new, old: new.to(old), found.estimate.motion, seen)
        told = observation._replace(
            motion=believed, velocity=rotate(believed.velocity, believed.heading)
        )
        action, inner = self.controller.act(state.inner, told)
        action = self._corrected(action, instruments)
        return Decided(action, EstimatingState(horizon, seen, action, instruments, inner))

    def _corrected(
        self, action: Float[Tensor, "b m"], instruments: Float[Tensor, "b 4"] | None
    ) -> Float[Tensor, "b m"]:
        """The command after which the wheel stands as wanted."""
        if instruments is None:
            return action
        offset, scale = instruments[:, :2].to(action).unbind(-1)
        driver = self.model.driver_input(self._unmoved(action), action)
        driver = driver._replace(steer=(driver.steer - offset) / scale)
        command = self.model.control_for_driver(self._unmoved(action), driver)
        lower, upper = (bound.to(action) for bound in self.model.bounds)
        return torch.minimum(torch.maximum(command, lower), upper)

    def _unmoved(self, action: Float[Tensor, "b m"]) -> Float[Tensor, "b n"]:
        return action.new_zeros(len(action), self.model.state_dim)

    def diagnosis(self, state: EstimatingState) -> dict[str, Float[Tensor, " E"]]:
        """What the other controller tells of itself, and the steering offset at the end in rad."""
        told = diagnosis_of(self.controller, state.inner)
        if state.instruments is None:
            return told
        return told | {"steer_offset": state.instruments[:, 0].float()}

    def thoughts(self, state: EstimatingState) -> dict[str, Float[np.ndarray, "E S *d"]]:
        """What the other controller expected and planned."""
        return thoughts_of(self.controller, state.inner)
