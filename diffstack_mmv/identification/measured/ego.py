"""State of the ego from its own past: a moving horizon of positions, steering and speed."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.identification.measured.estimation import (
    FreewheelGiven,
    InstrumentsGiven,
    estimate_windows,
)
from diffstack_mmv.identification.measured.instruments import InstrumentPriors
from diffstack_mmv.identification.measured.rides import RideWindows, chord_course
from diffstack_mmv.identification.measured.simulator import POSE, RECORDING, RideSimulator


class EgoMeasurement(NamedTuple):
    """What was measured at the end of a step, and on average in it."""

    position: Float[Tensor, "b 2"]  # m, of the antenna
    known: Bool[Tensor, " b"]  # whether there was a position
    steer: Float[Tensor, " b"]  # rad
    speed: Float[Tensor, " b"]  # m/s
    yaw_rate: Float[Tensor, " b"]  # rad/s, NaN without gyro


class EgoHorizon(NamedTuple):
    """What is kept from one measurement to the next."""

    past: EgoMeasurement  # b T1
    mean: Float[Tensor, "b 4"]  # of the unknowns of the instruments, from before the horizon
    precision: Float[Tensor, "b 4 4"]
    age: int  # steps since mean and precision were taken over


class EgoEstimate(NamedTuple):
    """The ego now.

    `instruments` are steering offset (rad) and scale, speed scale, delay (s): the true steering is
    scale times the measured one plus the offset.
    """

    state: Float[Tensor, "b n"]  # of the model
    instruments: Float[Tensor, "b 4"]
    instruments_std: Float[Tensor, "b 4"]


class EgoUpdate(NamedTuple):
    """An estimate, and what is remembered for the next."""

    estimate: EgoEstimate
    horizon: EgoHorizon


@dataclass(frozen=True)
class EgoEstimator:
    """Most probable path through the last measurements, by the dynamics themselves.

    Used like a forecaster: `init` with the first measurement, then a call per step. What came
    before the horizon is remembered as a prior of the instruments, which may drift.

    Attributes:
        simulator: Of the vehicle, with the noise of the measurements.
        shared: θ of the vehicle and place of the antenna, as fitted.
        priors: Of the instruments before the first measurement.
        steps: Length T of the horizon.
        with_gyro: Whether yaw rates are used.
        drift: Deviation of the instruments from one horizon to the next, in prior deviations.
        iterations: Steps of Levenberg and Marquardt per measurement.
    """

    simulator: RideSimulator
    shared: Tensor
    priors: InstrumentPriors = InstrumentPriors()
    steps: int = 20
    with_gyro: bool = False
    drift: float = 0.2
    iterations: int = 6

    def __post_init__(self) -> None:
        require_at_least("steps", self.steps, 5)

    def init(self, measurement: EgoMeasurement) -> EgoHorizon:
        """A horizon of which only the last instant is known."""
        count = len(measurement.steer)
        past = [part.unsqueeze(1).repeat_interleave(self.steps + 1, 1) for part in measurement]
        whole = EgoMeasurement(*past)
        earlier = torch.arange(self.steps + 1) < self.steps
        mean, std = self.priors.recording()
        return EgoHorizon(
            whole._replace(known=whole.known & ~earlier),
            mean.expand(count, -1),
            std.pow(-2).diag().expand(count, -1, -1),
            0,
        )

    def __call__(self, horizon: EgoHorizon, measurement: EgoMeasurement) -> EgoUpdate:
        """Take a measurement in."""
        past = EgoMeasurement(
            *(
                torch.cat([old[:, 1:], new.unsqueeze(1)], 1)
                for old, new in zip(horizon.past, measurement, strict=True)
            )
        )
        windows = self._windows(past)
        found = estimate_windows(
            self.simulator,
            windows,
            self.shared,
            InstrumentsGiven(
                horizon.mean, horizon.precision, FreewheelGiven.of(self.priors, len(horizon.mean))
            ),
            self.with_gyro,
            self.iterations,
        )
        path = self.simulator.simulate(windows, self.shared, found.local)
        own = slice(POSE, POSE + RECORDING)
        spread = found.covariance[:, own, own]
        # positions come first in every state, whatever else the model has
        now = path.states[:, -1].clone()
        now[:, :2] = now[:, :2] + windows.origin
        deviation = spread.diagonal(dim1=-2, dim2=-1).sqrt()
        estimate = EgoEstimate(now, found.recording, deviation)
        return EgoUpdate(estimate, self._remembered(horizon, past, found.recording, spread))

    def _remembered(
        self, horizon: EgoHorizon, past: EgoMeasurement, mean: Tensor, spread: Tensor
    ) -> EgoHorizon:
        """After a whole horizon its end becomes the prior of the next, which shares no sample."""
        if horizon.age + 1 < self.steps:
            return horizon._replace(past=past, age=horizon.age + 1)
        _, std = self.priors.recording()
        precision = torch.linalg.inv(spread + (self.drift * std).square().diag())
        return EgoHorizon(past, mean, precision, 0)

    def _windows(self, past: EgoMeasurement) -> RideWindows:
        steer, speed = past.steer[:, 1:], past.speed.clone()
        speed[:, 1:-1] = 0.5 * (past.speed[:, 1:-1] + past.speed[:, 2:])
        (rate,) = torch.gradient(steer, spacing=self.simulator.model.dt_s, dim=1)
        origin = past.position[:, 0]
        position = past.position - origin.unsqueeze(1)
        return RideWindows(
            torch.arange(len(origin)),
            tuple(str(number) for number in range(len(origin))),
            origin,
            position,
            chord_course(position),
            past.known,
            steer,
            rate,
            speed,
            past.yaw_rate[:, 1:],
            torch.full_like(speed, torch.nan),
        )
