"""From measured rides to fitted models and their errors on recordings that were left out."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.measured.baselines import Baselines
from diffstack_mmv.identification.measured.fit import MeasuredFit, MeasuredFitter
from diffstack_mmv.identification.measured.instruments import InstrumentPriors, MeasurementNoise
from diffstack_mmv.identification.measured.rides import (
    MeasuredRide,
    RideWindows,
    RideWindowSettings,
    cut_windows,
)
from diffstack_mmv.identification.measured.simulator import INSTALLED, RideSimulator
from diffstack_mmv.identification.measured.validation import (
    RolloutErrors,
    folds_by,
    future_errors,
    held_out_errors,
)
from diffstack_mmv.identification.shooting import ParameterVector
from diffstack_mmv.vehicles import VehicleSpec

logger = logging.getLogger(__name__)

NO_JUMPS_LEFT_OUT = 1e9

Models = Mapping[str, Callable[[], DynamicsModel]]


class Fitted(NamedTuple):
    """A model with its fit."""

    simulator: RideSimulator
    fit: MeasuredFit


class HeldOut(NamedTuple):
    """Errors of roll-outs whose recording took no part, without and with the history's gyro."""

    plain: RolloutErrors
    with_gyro: RolloutErrors


class ModelFit(NamedTuple):
    """One model: its fit, and its errors.

    Attributes:
        simulator: The model.
        fit: The fit of all recordings.
        by_recording: The rest of the recordings tells vehicle and priors; the noise is that of all.
        by_session: Vehicle, priors and noise come from the other sessions, fitted anew.
    """

    simulator: RideSimulator
    fit: MeasuredFit
    by_recording: HeldOut
    by_session: HeldOut


class MeasuredStudyResult(NamedTuple):
    """What a study found.

    Attributes:
        windows: Fitted windows.
        rollouts: Windows of the comparison.
        models: By name, the identified model first.
        baselines: Errors of what needs no model, what it fits coming from other recordings.
        noise: Deviations of all measurements.
        priors: Of the instruments.
    """

    windows: RideWindows
    rollouts: RideWindows
    models: dict[str, ModelFit]
    baselines: Mapping[str, RolloutErrors]
    noise: MeasurementNoise
    priors: InstrumentPriors

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
        fitter: The least squares, with the priors of the instruments to begin with.
        noise: Deviations of the measurements to begin with.
        noise_rounds: How often noise and priors are set to what the recordings tell of them under
            `reference`; 0 keeps both.
        fitted: Windows of the fit, which do not overlap.
        history_s: History of a roll-out.
        horizon_s: Its length after that.
        every_s: From the start of one roll-out to the next.
        reference: Model that noise and priors are learned with, and that all others start from;
            the first if it is not among them.
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

    def __call__(self, rides: Sequence[MeasuredRide], models: Models) -> MeasuredStudyResult:
        """Fit and compare models.

        Args:
            rides: All rides.
            models: Makes each model by its name; the first is the identified one.

        Raises:
            ValueError: No ride holds a window.
        """
        windows, rollouts = cut_windows(rides, self.fitted), cut_windows(rides, self._future())
        logger.info(
            "%d windows are fitted, %d are rolled out", len(windows.origin), len(rollouts.origin)
        )
        noise, fits = self._fits(windows, models)
        recordings = folds_by(rollouts.names, sessions=False)
        sessions = self._by_session(windows, rollouts, models)
        found = {}
        for name, (simulator, fit) in fits.items():
            plain, gyro = (
                held_out_errors(simulator, fit, rollouts, self.history_steps, recordings, with_gyro)
                for with_gyro in (False, True)
            )
            found[name] = ModelFit(simulator, fit, HeldOut(plain, gyro), sessions[name])
            logger.info("%s is judged", name)
        baselines = self._baselines().errors(rollouts, windows, folds_by(windows.names, False))
        priors = next(iter(fits.values())).fit.instruments.given
        return MeasuredStudyResult(windows, rollouts, found, baselines, noise, priors)

    def _future(self) -> RideWindowSettings:
        steps = self.history_steps + round(self.horizon_s / self.fitted.dt_s)
        every = round(self.every_s / self.fitted.dt_s)
        return replace(self.fitted, steps=steps, stride=every, jump_m=NO_JUMPS_LEFT_OUT)

    def _fits(
        self, windows: RideWindows, models: Models
    ) -> tuple[MeasurementNoise, dict[str, Fitted]]:
        """Fit all models; noise and priors are learned with the reference."""
        reference = self.reference if self.reference in models else next(iter(models))
        noise, fitter = self.noise, self.fitter
        first = self._simulator(models[reference], noise)
        fit = fitter(first, windows)
        for _ in range(self.noise_rounds):
            noise, fitter = replace(noise, **fit.sizes), replace(fitter, priors=fit.priors)
            first = self._simulator(models[reference], noise)
            fit = fitter(first, windows, fit.point)
        found = {reference: Fitted(first, fit)}
        for name in models:
            if name != reference:
                simulator = self._simulator(models[name], noise)
                start = simulator.parameters.start().double()
                shared = torch.cat([start, fit.point.shared[-INSTALLED:]])
                point = fitter.first_point(simulator, windows, shared, fit.point)
                found[name] = Fitted(simulator, fitter(simulator, windows, point))
                logger.info("%s: %d iterations", name, found[name].fit.iterations)
        return noise, {name: found[name] for name in models}

    def _by_session(
        self, windows: RideWindows, rollouts: RideWindows, models: Models
    ) -> dict[str, HeldOut]:
        """Errors of each session under everything learned on the others."""
        nothing = RolloutErrors.unknown(rollouts)
        found = {name: [nothing, nothing] for name in models}
        for fold in folds_by(windows.names, sessions=True):
            chosen = fold[rollouts.recording]
            if bool(fold.all()) or not bool(chosen.any()):
                continue
            _, fits = self._fits(windows.without(fold), models)
            part = rollouts.select(chosen)
            for name, (simulator, fit) in fits.items():
                priors, shared = fit.priors, fit.point.shared
                for index, gyro in enumerate((False, True)):
                    steps = self.history_steps
                    errors = future_errors(simulator, part, shared, priors, steps, gyro)
                    found[name][index] = found[name][index].filled(chosen, errors)
        return {name: HeldOut(*errors) for name, errors in found.items()}

    def _simulator(
        self, model: Callable[[], DynamicsModel], noise: MeasurementNoise
    ) -> RideSimulator:
        built = model().double()
        return RideSimulator(built, ParameterVector(built, self.spec), noise, self.spec)

    def _baselines(self) -> Baselines:
        wheelbase = self.spec.wheelbase.entries()[0][0]
        return Baselines(self.history_steps, self.fitted.dt_s, wheelbase)
