"""From measured rides to fitted models and their errors on recordings that were left out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.measured.fit import MeasuredFit, MeasuredFitter, RideUnknowns
from diffstack_mmv.identification.measured.instruments import MeasurementNoise
from diffstack_mmv.identification.measured.rides import (
    MeasuredRide,
    RideWindows,
    RideWindowSettings,
    cut_windows,
)
from diffstack_mmv.identification.measured.simulator import ANTENNA, RideSimulator
from diffstack_mmv.identification.measured.validation import (
    RolloutErrors,
    baseline_errors,
    folds_by,
    held_out_errors,
)
from diffstack_mmv.identification.shooting import ParameterVector
from diffstack_mmv.vehicles import VehicleSpec

NO_JUMPS_LEFT_OUT = 1e9


class ModelFit(NamedTuple):
    """One model: its fit, and the errors of windows held out by recording and by session."""

    simulator: RideSimulator
    fit: MeasuredFit
    by_recording: RolloutErrors
    by_session: RolloutErrors
    with_gyro: RolloutErrors  # by recording, yaw rates of the history used


class MeasuredStudyResult(NamedTuple):
    """What a study found.

    Attributes:
        windows: Fitted windows.
        rollouts: Windows of the comparison.
        models: By name, the identified model first.
        baselines: Errors of what needs no fit.
        noise: Deviations of all measurements.
    """

    windows: RideWindows
    rollouts: RideWindows
    models: dict[str, ModelFit]
    baselines: Mapping[str, RolloutErrors]
    noise: MeasurementNoise

    def calibrated(self, spec: VehicleSpec, source: str) -> VehicleSpec:
        """The vehicle with the values of every model, those of the identified one last."""
        for found in reversed(self.models.values()):
            vector = found.simulator.parameters
            theta = found.fit.point.shared[: len(vector)]
            spec = spec.with_values(vector.calibrated(theta), source)
        return spec


@dataclass(frozen=True)
class MeasuredStudy:
    """Fits models to the same windows under the same assumptions.

    Attributes:
        spec: The vehicle.
        fitter: The least squares, with the priors of the instruments.
        noise: Deviations of the measurements.
        noise_rounds: How often the noise is set to what explains the residuals of `reference`
            best; 0 keeps it.
        fitted: Windows of the fit, which do not overlap.
        history_s: History of a roll-out.
        horizon_s: Its length after that.
        every_s: From the start of one roll-out to the next.
        reference: Model whose residuals set the noise of all, and that all others start from.
    """

    spec: VehicleSpec
    fitter: MeasuredFitter = MeasuredFitter()
    noise: MeasurementNoise = MeasurementNoise()
    noise_rounds: int = 4
    fitted: RideWindowSettings = RideWindowSettings()
    history_s: float = 2.0
    horizon_s: float = 3.0
    every_s: float = 1.0
    reference: str = "kbm"

    @property
    def history_steps(self) -> int:
        """Steps of the history of a roll-out."""
        return round(self.history_s / self.fitted.dt_s)

    def __call__(
        self, rides: Sequence[MeasuredRide], models: Mapping[str, Callable[[], DynamicsModel]]
    ) -> MeasuredStudyResult:
        """Fit and compare models.

        Args:
            rides: All rides.
            models: Makes each model by its name; the first is the identified one.

        Raises:
            ValueError: No ride holds a window.
        """
        windows = cut_windows(rides, self.fitted)
        steps = self.history_steps + round(self.horizon_s / self.fitted.dt_s)
        every = round(self.every_s / self.fitted.dt_s)
        far = replace(self.fitted, steps=steps, stride=every, jump_m=NO_JUMPS_LEFT_OUT)
        rollouts = cut_windows(rides, far)
        order = sorted(models, key=lambda name: name != self.reference)
        noise, start, found = self.noise, None, {}
        for name in order:
            rounds = self.noise_rounds if start is None else 0
            for _ in range(rounds):
                first = self._fit(models[name], windows, noise, start)
                noise, start = replace(noise, **first[1].sizes), first[1].point
            simulator, fit = self._fit(models[name], windows, noise, start)
            start = fit.point if start is None or name == order[0] else start
            found[name] = self._judged(simulator, fit, rollouts)
        baselines = self._baselines(rollouts)
        ordered = {name: found[name] for name in models}
        return MeasuredStudyResult(windows, rollouts, ordered, baselines, noise)

    def _fit(
        self,
        model: Callable[[], DynamicsModel],
        windows: RideWindows,
        noise: MeasurementNoise,
        start: RideUnknowns | None,
    ) -> tuple[RideSimulator, MeasuredFit]:
        built = model().double()
        parameters = ParameterVector(built, self.spec)
        simulator = RideSimulator(built, parameters, noise, self.spec)
        if start is not None:
            antenna = start.shared[-ANTENNA:]
            start = start._replace(shared=torch.cat([parameters.start().double(), antenna]))
        return simulator, self.fitter(simulator, windows, start)

    def _judged(
        self, simulator: RideSimulator, fit: MeasuredFit, rollouts: RideWindows
    ) -> ModelFit:
        def errors(folds: list[Tensor], with_gyro: bool) -> RolloutErrors:
            return held_out_errors(
                simulator, fit, rollouts, self.fitter.priors, self.history_steps, folds, with_gyro
            )

        recordings = folds_by(rollouts.names, sessions=False)
        sessions = folds_by(rollouts.names, sessions=True)
        return ModelFit(
            simulator,
            fit,
            errors(recordings, False),
            errors(sessions, False),
            errors(recordings, True),
        )

    def _baselines(self, rollouts: RideWindows) -> Mapping[str, RolloutErrors]:
        wheelbase = self.spec.wheelbase.entries()[0][0]
        return baseline_errors(rollouts, self.history_steps, self.fitted.dt_s, wheelbase)
