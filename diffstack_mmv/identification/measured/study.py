"""From measured rides to fitted models and their errors on recordings that were left out."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.measured.baselines import Baselines
from diffstack_mmv.identification.measured.fit import MeasuredFitter
from diffstack_mmv.identification.measured.fitted import MeasuredFit
from diffstack_mmv.identification.measured.instruments import InstrumentPriors, MeasurementNoise
from diffstack_mmv.identification.measured.parts import FinishedParts
from diffstack_mmv.identification.measured.rides import (
    MeasuredRide,
    RideWindows,
    RideWindowSettings,
    cut_windows,
)
from diffstack_mmv.identification.measured.simulator import RideSimulator
from diffstack_mmv.identification.measured.stages import Fitted, Fitting, HeldOut, Judging, Models
from diffstack_mmv.identification.measured.validation import RolloutErrors, folds_by
from diffstack_mmv.vehicles import VehicleSpec

logger = logging.getLogger(__name__)

NO_JUMPS_LEFT_OUT = 1e9


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
        seconds: Processor time of each model, all folds included.
    """

    windows: RideWindows
    rollouts: RideWindows
    models: dict[str, ModelFit]
    baselines: Mapping[str, RolloutErrors]
    noise: MeasurementNoise
    priors: InstrumentPriors
    seconds: Mapping[str, float]

    def calibrated(self, spec: VehicleSpec, source: str) -> VehicleSpec:
        """The vehicle with the values of the identified model; what others fit is in the report."""
        first = next(iter(self.models.values()))
        vector = first.simulator.parameters
        theta = first.fit.point.shared[: len(vector)]
        return spec.with_values(vector.calibrated(theta), source)


@dataclass(frozen=True)
class MeasuredStudy:
    """Fits models to the same windows under the same assumptions.

    Attributes:
        spec: The vehicle.
        fitter: The least squares, with the priors of the instruments to begin with.
        noise: Deviations of the measurements to begin with.
        noise_rounds: How often at most noise and priors are set to what the recordings tell of
            them under `reference`, until the evidence hardly rises; 0 keeps both.
        fitted: Windows of the fit, which do not overlap.
        history_s: History of a roll-out.
        horizon_s: Its length after that.
        every_s: From the start of one roll-out to the next.
        reference: Model that noise and priors are learned with, and that all others start from;
            the first if it is not among them.
        parts: Keeps what is finished.

    Raises:
        ValueError: A number is too small.
    """

    spec: VehicleSpec
    fitter: MeasuredFitter = MeasuredFitter()
    noise: MeasurementNoise = MeasurementNoise()
    noise_rounds: int = 40
    fitted: RideWindowSettings = RideWindowSettings()
    history_s: float = 2.0
    horizon_s: float = 3.0
    every_s: float = 1.0
    reference: str = "kbm"
    parts: FinishedParts = FinishedParts()

    def __post_init__(self) -> None:
        require_at_least("noise_rounds", self.noise_rounds, 0)
        for name in ("history_s", "horizon_s", "every_s"):
            require_at_least(name, getattr(self, name), self.fitted.dt_s)

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
        names = self._ordered(models)
        fitting = self._fitting(windows, rollouts, names[0])
        judging = Judging(fitting, rollouts, self.history_steps)
        whole: dict[str, Fitted] = {}
        by_recording: dict[str, HeldOut] = {}
        by_session: dict[str, HeldOut] = {}
        for name in names:
            model, reference = models[name], whole.get(names[0])
            whole[name] = fitting.fitted("all", windows, name, model, reference)
            logger.info("%s: %d iterations", name, whole[name].fit.iterations)
            known = by_recording.get(names[0])
            by_recording[name] = judging.by_recording(name, whole[name], known)
            by_session[name] = judging.by_session(name, model, windows, whole[name].fit)
            logger.info("%s is judged: %.0f processor seconds", name, fitting.seconds[name])
        found = {
            name: ModelFit(*whole[name], by_recording[name], by_session[name]) for name in models
        }
        baselines = self._baselines().errors(rollouts, windows, folds_by(windows.names, False))
        first = whole[names[0]]
        noise, priors = first.simulator.noise, first.fit.instruments.given
        seconds = {name: fitting.seconds[name] for name in models}
        return MeasuredStudyResult(windows, rollouts, found, baselines, noise, priors, seconds)

    def require_models(self, models: Models) -> None:
        """Refuse models that no steering angle drives, before the work begins.

        Args:
            models: As for the study itself.

        Raises:
            ValueError: A model does not say what a steering angle does.
        """
        for build in models.values():
            model = build()
            idle = (torch.zeros(size) for size in (model.state_dim, model.control_dim))
            model.driver_input(*idle)

    def _fitting(self, windows: RideWindows, rollouts: RideWindows, reference: str) -> "Fitting":
        """How models are fitted, what is finished found again for the same data and settings."""
        settings = (self.spec, self.fitter, self.noise, self.noise_rounds, self.fitted)
        times_s = (self.history_s, self.horizon_s, self.every_s)
        parts = self.parts.keyed(*windows, *rollouts, *settings, *times_s, reference)
        return Fitting(self.spec, self.fitter, self.noise, self.noise_rounds, parts)

    def whole(
        self, rides: Sequence[MeasuredRide], name: str, model: Callable[[], DynamicsModel]
    ) -> tuple[RideWindows, RideWindows, Fitted]:
        """Windows, roll-outs, and the fit of the reference to all recordings."""
        windows, rollouts = cut_windows(rides, self.fitted), cut_windows(rides, self._future())
        fitting = self._fitting(windows, rollouts, name)
        return windows, rollouts, fitting.fitted("all", windows, name, model, None)

    def _future(self) -> RideWindowSettings:
        steps = self.history_steps + round(self.horizon_s / self.fitted.dt_s)
        every = round(self.every_s / self.fitted.dt_s)
        return replace(self.fitted, steps=steps, stride=every, jump_m=NO_JUMPS_LEFT_OUT)

    def _ordered(self, models: Models) -> list[str]:
        """The reference first."""
        return sorted(models, key=lambda name: name != self.reference)

    def _baselines(self) -> Baselines:
        wheelbase = self.spec.wheelbase.entries()[0][0]
        return Baselines(self.history_steps, self.fitted.dt_s, wheelbase)
