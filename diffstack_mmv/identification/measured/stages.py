"""Stages of a study: fits of all recordings and without a session, and roll-outs of both."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.measured.elimination import RideUnknowns
from diffstack_mmv.identification.measured.fit import MeasuredFitter
from diffstack_mmv.identification.measured.fitted import MeasuredFit
from diffstack_mmv.identification.measured.given import InstrumentsGiven
from diffstack_mmv.identification.measured.instruments import SIZES, MeasurementNoise
from diffstack_mmv.identification.measured.parts import (
    SECONDS,
    FinishedParts,
    Part,
    priors_as_tensor,
    priors_from_tensor,
)
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import INSTALLED, RideSimulator
from diffstack_mmv.identification.measured.validation import (
    RolloutErrors,
    folds_by,
    future_errors,
    held_out_errors,
    session_of,
)
from diffstack_mmv.identification.shooting import ParameterVector
from diffstack_mmv.vehicles import VehicleSpec
from dmmv_conventions.progress import counted

Models = Mapping[str, Callable[[], DynamicsModel]]

LEAST_RISE = 1.0
"""Of the logarithm of the evidence, for another round of learning noise and priors."""


class Fitted(NamedTuple):
    """A model with its fit."""

    simulator: RideSimulator
    fit: MeasuredFit


class HeldOut(NamedTuple):
    """Errors of roll-outs whose recording took no part, without and with the history's gyro."""

    plain: RolloutErrors
    with_gyro: RolloutErrors


class Start(NamedTuple):
    """Where the fit of some of the recordings begins."""

    point: RideUnknowns
    tilt: Tensor


@dataclass(frozen=True)
class Fitting:
    """Fits models to windows, one after the other.

    Attributes:
        spec: The vehicle.
        fitter: The least squares, with the priors to begin with.
        noise: Deviations to begin with.
        rounds: How often noise and priors are learned with the reference.
        parts: Keeps what is finished.
        seconds: Processor time by model, filled in on the way.
    """

    spec: VehicleSpec
    fitter: MeasuredFitter
    noise: MeasurementNoise
    rounds: int
    parts: FinishedParts
    seconds: dict[str, float] = field(default_factory=dict)

    def fitted(
        self,
        label: str,
        windows: RideWindows,
        name: str,
        model: Callable[[], DynamicsModel],
        reference: Fitted | None,
        start: Start | None = None,
    ) -> Fitted:
        """Fit a model.

        Args:
            label: Of the recordings.
            windows: Their windows.
            name: Of the model.
            model: Makes it.
            reference: The model that noise and priors were learned with; they are learned with this
                one if there is none yet.
            start: Where the fit begins; only a start, all is learned from the windows.
        """

        def make() -> Part:
            if reference is None:
                return _kept(self._learned(windows, model, start))
            return _kept(self._given(windows, model, reference, start))

        # a name says little of a model: another tyre law may stand behind it
        told = [model().description()]
        told += [] if reference is None else [reference.simulator.model.description()]
        part = self.part(name, self.parts.keyed(told)(f"{label}-{name}", make))
        fitter = replace(self.fitter, priors=priors_from_tensor(part["priors"]))
        noise = replace(self.noise, **dict(zip(SIZES, part["noise"].tolist(), strict=True)))
        simulator = self.simulator(model, noise)
        columns = (part[name] for name in RideUnknowns._fields)
        point, taken = RideUnknowns(*columns), int(part["iterations"])
        ended = bool(part["converged"])
        fit = fitter.result(simulator, windows, point, part["tilt"], taken, ended)
        return Fitted(simulator, fit)

    def part(self, name: str, part: Part) -> Part:
        """A part of a model, whose processor time is added to that of the model."""
        self.seconds[name] = self.seconds.get(name, 0.0) + float(part[SECONDS])
        return part

    def simulator(
        self, model: Callable[[], DynamicsModel], noise: MeasurementNoise
    ) -> RideSimulator:
        """Of a model under a noise."""
        built = model().double()
        return RideSimulator(built, ParameterVector(built, self.spec), noise, self.spec)

    def _learned(
        self, windows: RideWindows, model: Callable[[], DynamicsModel], start: Start | None
    ) -> Fitted:
        """Noise, priors and what coasts are learned by expectation and maximisation.

        Its steps become small long before its end: it ends where the evidence hardly rises.
        """
        noise, fitter = self.noise, self.fitter
        simulator = self.simulator(model, noise)
        point, tilt = start or (None, None)
        best = Fitted(simulator, fitter(simulator, windows, point, tilt))
        for _ in range(self.rounds):
            fit = best.fit
            noise, fitter = replace(noise, **fit.sizes), replace(fitter, priors=fit.priors)
            simulator = self.simulator(model, noise)
            point = fitter.coasting_again(simulator, windows, fit.point)
            found = Fitted(simulator, fitter(simulator, windows, point, tilt))
            rise = found.fit.log_evidence - fit.log_evidence
            best = found if rise > 0 else best
            if rise < LEAST_RISE:
                break
        return best

    def _given(
        self,
        windows: RideWindows,
        model: Callable[[], DynamicsModel],
        reference: Fitted,
        start: Start | None,
    ) -> Fitted:
        """Under the noise and the priors of the reference, what coasts included."""
        known, priors = reference.fit.point, reference.fit.instruments.given
        fitter = replace(self.fitter, priors=priors)
        simulator = self.simulator(model, reference.simulator.noise)
        if start is None:
            theta = simulator.parameters.start().double()
            shared = torch.cat([theta, known.shared[-INSTALLED:]])
            point = fitter.first_point(simulator, windows, shared, known.recording, known.coasting)
            return Fitted(simulator, fitter(simulator, windows, point))
        point = start.point
        if bool((point.coasting != known.coasting).any()):
            point = fitter.first_point(
                simulator, windows, point.shared, point.recording, known.coasting
            )
        return Fitted(simulator, fitter(simulator, windows, point, start.tilt))


@dataclass(frozen=True)
class Judging:
    """Errors of roll-outs that took no part.

    Attributes:
        fitting: Fits what a session is judged by.
        rollouts: History and future.
        history: Steps of the history.
        references: Fit and errors of the reference by left out session, filled in on the way.
    """

    fitting: Fitting
    rollouts: RideWindows
    history: int
    references: dict[int, tuple[Fitted, HeldOut]] = field(default_factory=dict)

    def by_recording(self, name: str, fitted: Fitted, reference: HeldOut | None) -> HeldOut:
        """Each recording under vehicle and priors of the others.

        Args:
            name: Of the model.
            fitted: Its fit of all recordings, from which each is taken out.
            reference: Errors of the reference, which says what coasts; the model itself by default.
        """
        folds = folds_by(self.rollouts.names, sessions=False)

        def errors(gyro: bool, coasting: Tensor | None) -> RolloutErrors:
            simulator, fit = fitted
            settings = (self.history, folds, gyro, coasting)
            return held_out_errors(simulator.under(fit.noise), fit, self.rollouts, *settings)

        return self._judged(f"recordings-{name}", name, fitted, errors, reference)

    def by_session(
        self,
        name: str,
        model: Callable[[], DynamicsModel],
        windows: RideWindows,
        whole: MeasuredFit,
    ) -> HeldOut:
        """Each session under everything learned on the others.

        Args:
            name: Of the model; the first that is judged is the reference of the others.
            model: Makes it.
            windows: Windows of all fits.
            whole: Its fit of all recordings, where those without a session begin.
        """
        nothing = RolloutErrors.unknown(self.rollouts)
        found = HeldOut(nothing, nothing)
        folds = folds_by(windows.names, sessions=True)
        for number, fold in enumerate(counted(folds, f"{name}: leave out sessions", "session")):
            chosen = fold[self.rollouts.recording]
            if bool(fold.all()) or not bool(chosen.any()):
                continue
            one = self._without(fold, name, model, windows, whole, self.references.get(number))
            self.references.setdefault(number, one)
            pairs = zip(found, one[1], strict=True)
            found = HeldOut(*(old.filled(chosen, new) for old, new in pairs))
        return found

    def _without(
        self,
        fold: Tensor,
        name: str,
        model: Callable[[], DynamicsModel],
        windows: RideWindows,
        whole: MeasuredFit,
        reference: tuple[Fitted, HeldOut] | None,
    ) -> tuple[Fitted, HeldOut]:
        """Fit without a session, and the errors of that session."""
        session = session_of(windows.names[int(fold.long().argmax())])
        start = Start(whole.point.without(fold, windows.recording), whole.tilt[~fold])
        first, judged = reference or (None, None)
        label, rest = f"without-{session}", windows.without(fold)
        fitted = self.fitting.fitted(label, rest, name, model, first, start)
        part = self.rollouts.select(fold[self.rollouts.recording])

        def errors(gyro: bool, coasting: Tensor | None) -> RolloutErrors:
            simulator, fit = fitted
            given = InstrumentsGiven.of(fit.priors, len(part.recording))
            known = (fit.point.shared, given, self.history, gyro, coasting)
            return future_errors(simulator.under(fit.noise), part, *known)

        return fitted, self._judged(f"session-{session}-{name}", name, fitted, errors, judged)

    def _judged(
        self,
        label: str,
        name: str,
        fitted: Fitted,
        errors: Callable[[bool, Tensor | None], RolloutErrors],
        reference: HeldOut | None,
    ) -> HeldOut:
        """Errors of a fit without and with gyro; what coasts is as in those of the reference."""
        coasting = [each.coasting for each in reference or ()]

        def make() -> Part:
            both = [errors(gyro, coasting[gyro] if coasting else None) for gyro in (False, True)]
            return {
                f"{field}_{index}": value
                for index, each in enumerate(both)
                for field, value in each._asdict().items()
            }

        made_of = fitted.simulator.model.description(), *fitted.fit.point, *coasting
        part = self.fitting.part(name, self.fitting.parts.keyed(*made_of)(label, make))
        columns = [[part[f"{name}_{index}"] for name in RolloutErrors._fields] for index in (0, 1)]
        return HeldOut(*(RolloutErrors(*each) for each in columns))


def _kept(fitted: Fitted) -> Part:
    """What a fit is restored from."""
    simulator, fit = fitted
    sizes = [getattr(simulator.noise, name) for name in SIZES]
    return {
        **fit.point._asdict(),
        "tilt": fit.tilt,
        "iterations": torch.tensor(fit.iterations),
        "converged": torch.tensor(fit.converged),
        "noise": torch.tensor(sizes, dtype=torch.float64),
        "priors": priors_as_tensor(fit.instruments.given),
    }
