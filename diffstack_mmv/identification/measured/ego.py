"""State of the ego from its own past: a moving horizon of positions, steering and speed."""

import copy
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import direction
from diffstack_mmv.identification.measured.estimation import WindowEstimate, estimate_windows
from diffstack_mmv.identification.measured.given import (
    CourseGiven,
    FreewheelGiven,
    InstrumentsGiven,
)
from diffstack_mmv.identification.measured.instruments import InstrumentPriors, MeasurementNoise
from diffstack_mmv.identification.measured.rides import RideWindows, chord_course
from diffstack_mmv.identification.measured.simulator import POSE, RECORDING, RideSimulator
from diffstack_mmv.identification.shooting import ParameterVector
from diffstack_mmv.types import EgoEstimate, EgoMeasurement
from diffstack_mmv.vehicles import VehicleSpec, turning_axle_m

SLIP_RAD = 0.03
"""By how much a vehicle may point aside of its course."""


class EgoHorizon(NamedTuple):
    """What is kept from one measurement to the next."""

    past: EgoMeasurement  # b T1
    # what was known at each instant: at the start of a window it shares no step with the window
    mean: Float[Tensor, "b T1 4"]  # of the unknowns of the instruments
    precision: Float[Tensor, "b T1 4 4"]
    course: CourseGiven  # b T1


class EgoUpdate(NamedTuple):
    """An estimate, and what is remembered for the next."""

    estimate: EgoEstimate
    horizon: EgoHorizon


@dataclass(frozen=True)
class EgoEstimator:
    """Most probable path through the last measurements, by the dynamics themselves.

    Used like a forecaster: `init` with the first measurement, then a call per step. What came
    before the horizon is remembered as a prior: of the instruments, which may drift, and of the
    course at its start, as a vehicle that stands does not tell where it points.

    Attributes:
        simulator: Of the vehicle, with the noise of the measurements.
        shared: θ of the vehicle and place of the antenna, as fitted.
        priors: Of the instruments before the first measurement.
        steps: Length T of the horizon.
        with_gyro: Whether yaw rates are used.
        course_std: Deviation of a course that `init` is told, rad.
        drift: Deviation of the instruments from one horizon to the next, in prior deviations.
        iterations: Steps of Levenberg and Marquardt per measurement.
    """

    simulator: RideSimulator
    shared: Tensor
    priors: InstrumentPriors = InstrumentPriors()
    steps: int = 20
    with_gyro: bool = False
    course_std: float = 0.02
    drift: float = 1.0
    iterations: int = 6

    def __post_init__(self) -> None:
        require_at_least("steps", self.steps, 5)

    def init(
        self, measurement: EgoMeasurement, course: Float[Tensor, " b"] | None = None
    ) -> EgoHorizon:
        """A horizon of which only the last instant is known.

        Args:
            measurement: The first one.
            course: Where the vehicle points in rad, if it is known and the vehicle stands.
        """
        count, ends = len(measurement.steer), self.steps + 1
        past = [part.unsqueeze(1).repeat_interleave(ends, 1) for part in measurement]
        whole = EgoMeasurement(*past)
        earlier = torch.arange(ends) < self.steps
        mean, std = self.priors.recording()
        pointed = CourseGiven.unknown(count)
        if course is not None:
            pointed = CourseGiven(course.double(), torch.full_like(pointed.std, self.course_std))
        known = whole._replace(known=whole.known & ~earlier)
        precision = std.pow(-2).diag().expand(count, ends, -1, -1)
        always = CourseGiven(*(part.unsqueeze(1).repeat_interleave(ends, 1) for part in pointed))
        return EgoHorizon(known, mean.expand(count, ends, -1), precision, always)

    def __call__(self, horizon: EgoHorizon, measurement: EgoMeasurement) -> EgoUpdate:
        """Take a measurement in."""
        past = EgoMeasurement(
            *(_later(*pair) for pair in zip(horizon.past, measurement, strict=True))
        )
        windows = self._windows(past)
        start = CourseGiven(*(part[:, 1] for part in horizon.course))
        freewheel = FreewheelGiven.of(self.priors, len(horizon.mean))
        given = InstrumentsGiven(horizon.mean[:, 1], horizon.precision[:, 1], freewheel, start)
        found = estimate_windows(
            self.simulator, windows, self.shared, given, self.with_gyro, self.iterations
        )
        estimate = self._present(windows, found)
        now = self._course(windows, found, estimate.motion.heading)
        after = EgoHorizon(
            past,
            _later(horizon.mean, found.recording),
            _later(horizon.precision, self._drifted(found)),
            CourseGiven(*(_later(*pair) for pair in zip(horizon.course, now, strict=True))),
        )
        return EgoUpdate(estimate, after)

    def _present(self, windows: RideWindows, found: WindowEstimate) -> EgoEstimate:
        """The end of the most probable path."""
        model = self.simulator.model
        path = self.simulator.simulate(windows, self.shared, found.local)
        now = path.states[:, -1].clone()
        idle = now.new_zeros(len(now), model.control_dim)
        ahead = self.simulator.lead_s * path.speed[:, -1:]
        # positions come first in every state, whatever else the model has
        now[:, :2] += windows.origin + ahead * direction(model.motion(now, idle).heading)
        motion = model.motion(now, idle)
        own = slice(POSE, POSE + RECORDING)
        deviation = found.covariance[:, own, own].diagonal(dim1=-2, dim2=-1).sqrt()
        return EgoEstimate(now, motion, found.recording, deviation)

    def _course(
        self, windows: RideWindows, found: WindowEstimate, heading: Float[Tensor, " b"]
    ) -> CourseGiven:
        """Course at the end of a window: that at its start, and the sum of its yaw rates."""
        yaw_rates = found.slopes[:, 2 * windows.position.shape[1] :]
        slope = self.simulator.model.dt_s * yaw_rates.sum(1)
        slope[:, POSE - 1] += 1
        variance = (slope.unsqueeze(1) @ found.covariance @ slope.unsqueeze(-1)).flatten()
        return CourseGiven(heading, (variance + SLIP_RAD**2).sqrt())

    def _drifted(self, found: WindowEstimate) -> Float[Tensor, "b 4 4"]:
        """Precision of the instruments a horizon later."""
        own = slice(POSE, POSE + RECORDING)
        _, std = self.priors.recording()
        spread = found.covariance[:, own, own] + (self.drift * std).square().diag()
        return torch.linalg.inv(spread)

    def _windows(self, past: EgoMeasurement) -> RideWindows:
        # means over steps, straight on after the last
        steer, onward = past.steer[:, 1:], 2 * past.speed[:, -1:] - past.speed[:, -2:-1]
        speed = 0.5 * (past.speed + torch.cat([past.speed[:, 1:], onward], 1))
        (rate,) = torch.gradient(steer, spacing=self.simulator.model.dt_s, dim=1)
        origin = past.position[:, 0]
        position = past.position - origin.unsqueeze(1)
        return RideWindows(
            recording=torch.arange(len(origin)),
            names=tuple(str(number) for number in range(len(origin))),
            origin=origin,
            position=position,
            course=chord_course(position),
            known=past.known,
            steer=steer,
            steer_rate=rate,
            speed=speed,
            yaw_rate=past.yaw_rate[:, 1:],
            lean=torch.full_like(speed, torch.nan),
        )


def ego_estimator(
    model: DynamicsModel,
    spec: VehicleSpec,
    noise: MeasurementNoise,
    priors: InstrumentPriors,
    horizon_s: float = 2.0,
    with_gyro: bool = False,
    drift: float = 1.0,
    iterations: int = 6,
) -> EgoEstimator:
    """An estimator of a vehicle whose measured position is that of its model's reference point.

    Args:
        model: What is believed of the vehicle; its step is the time between two measurements.
        spec: The vehicle, whose learned parameters are taken to be those of the model.
        noise: Of the measurements.
        priors: Of the instruments before the first measurement.
        horizon_s: Length of the horizon in s.
        with_gyro: Whether yaw rates are used.
        drift: Deviation of the instruments from one horizon to the next, in prior deviations.
        iterations: Steps of Levenberg and Marquardt per measurement.

    Raises:
        ValueError: The horizon is shorter than five steps.
    """
    exact = copy.deepcopy(model).double()
    parameters = ParameterVector(exact, spec)
    simulator = RideSimulator(exact, parameters, noise, spec)
    installed = exact.reference_ahead_m - turning_axle_m(spec.wheels), 0.0, 1.0
    shared = torch.cat([parameters.start(), parameters.raw.new_tensor(installed)])
    return EgoEstimator(
        simulator,
        shared,
        priors,
        round(horizon_s / exact.dt_s),
        with_gyro,
        drift=drift,
        iterations=iterations,
    )


def _later(old: Tensor, new: Tensor) -> Tensor:
    """A window of instants one step later."""
    return torch.cat([old[:, 1:], new.unsqueeze(1)], 1)
