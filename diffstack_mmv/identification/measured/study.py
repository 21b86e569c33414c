"""From measured rides to fitted models and their errors on recordings that were left out."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.measured.baselines import Baselines
from diffstack_mmv.identification.measured.elimination import RideUnknowns
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


Fits = Mapping[str, Fitted]


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
        sessions = self._by_session(windows, rollouts, models, fits)
        recordings = folds_by(rollouts.names, sessions=False)
        found: dict[str, ModelFit] = {}
        coasting: dict[bool, Tensor] = {}
        for name in self._ordered(models):
            simulator, fit = fits[name]
            errors = []
            for gyro in (False, True):
                steps, known = self.history_steps, coasting.get(gyro)
                judged = held_out_errors(simulator, fit, rollouts, steps, recordings, gyro, known)
                coasting.setdefault(gyro, judged.coasting)
                errors.append(judged)
            found[name] = ModelFit(simulator, fit, HeldOut(*errors), sessions[name])
            logger.info("%s is judged", name)
        found = {name: found[name] for name in models}
        baselines = self._baselines().errors(rollouts, windows, folds_by(windows.names, False))
        priors = next(iter(fits.values())).fit.instruments.given
        return MeasuredStudyResult(windows, rollouts, found, baselines, noise, priors)

    def _future(self) -> RideWindowSettings:
        steps = self.history_steps + round(self.horizon_s / self.fitted.dt_s)
        every = round(self.every_s / self.fitted.dt_s)
        return replace(self.fitted, steps=steps, stride=every, jump_m=NO_JUMPS_LEFT_OUT)

    def _ordered(self, models: Models) -> list[str]:
        """The reference first."""
        return sorted(models, key=lambda name: name != self.reference)

    def _fits(
        self,
        windows: RideWindows,
        models: Models,
        starts: Mapping[str, RideUnknowns] | None = None,
    ) -> tuple[MeasurementNoise, dict[str, Fitted]]:
        """Fit all models; noise and priors are learned with the reference.

        Args:
            windows: The windows.
            models: Makes each model.
            starts: Where each fit begins; only a start, all is learned from the windows.
        """
        reference, *others = self._ordered(models)
        noise, fitter, starts = self.noise, self.fitter, starts or {}
        simulator = self._simulator(models[reference], noise)
        fit = fitter(simulator, windows, starts.get(reference))
        for _ in range(self.noise_rounds):
            noise, fitter = replace(noise, **fit.sizes), replace(fitter, priors=fit.priors)
            simulator = self._simulator(models[reference], noise)
            fit = fitter(simulator, windows, fit.point)
        found = {reference: Fitted(simulator, fit)}
        for name in others:
            simulator, point = self._simulator(models[name], noise), starts.get(name)
            if point is None:
                start = simulator.parameters.start().double()
                shared = torch.cat([start, fit.point.shared[-INSTALLED:]])
                point = fitter.first_point(simulator, windows, shared, fit.point)
            found[name] = Fitted(simulator, fitter(simulator, windows, point))
            logger.info("%s: %d iterations", name, found[name].fit.iterations)
        return noise, {name: found[name] for name in models}

    def _by_session(
        self, windows: RideWindows, rollouts: RideWindows, models: Models, whole: Fits
    ) -> dict[str, HeldOut]:
        """Errors of each session under everything learned on the others."""
        nothing = RolloutErrors.unknown(rollouts)
        found = {name: [nothing, nothing] for name in models}
        for fold in folds_by(windows.names, sessions=True):
            chosen = fold[rollouts.recording]
            if bool(fold.all()) or not bool(chosen.any()):
                continue
            starts = {
                name: fit.point.without(fold, windows.recording) for name, (_, fit) in whole.items()
            }
            _, fits = self._fits(windows.without(fold), models, starts)
            part = rollouts.select(chosen)
            coasting: dict[int, Tensor] = {}
            for name in self._ordered(models):
                simulator, fit = fits[name]
                for index, gyro in enumerate((False, True)):
                    given = (fit.point.shared, fit.priors, self.history_steps, gyro)
                    errors = future_errors(simulator, part, *given, coasting.get(index))
                    coasting.setdefault(index, errors.coasting)
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
