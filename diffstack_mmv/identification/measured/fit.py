"""Joint fit of a vehicle, its instruments and all windows."""

import logging
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_switch
from diffstack_mmv.identification.measured.elimination import (
    Damping,
    Linearisation,
    RideEquations,
    RideUnknowns,
    without_recording,
)
from diffstack_mmv.identification.measured.estimation import WindowEstimate, estimate_windows
from diffstack_mmv.identification.measured.evidence import (
    heard_noise,
    learned_instruments,
    noise_sizes,
)
from diffstack_mmv.identification.measured.fitted import MeasuredFit, jackknife
from diffstack_mmv.identification.measured.given import (
    CourseGiven,
    FreewheelGiven,
    InstrumentsGiven,
)
from diffstack_mmv.identification.measured.instruments import InstrumentPriors
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.shared import SharedUnknowns
from diffstack_mmv.identification.measured.simulator import RideSimulator
from diffstack_mmv.identification.measured.volume import evidence, tilt_change

logger = logging.getLogger(__name__)

STEPS_BACK = 9
FIRST_DAMPING = 1e-4

LEAST_GAIN, LEAST_SHARE = 0.01, 0.1
"""Logarithm of evidence, and share of a change of the tilt, that are worth another search."""

SURE = 1e4
"""Factor on the precision of instruments that are given."""


class _Lowest(NamedTuple):
    """End of a search."""

    at: Linearisation
    taken: int
    converged: bool


@dataclass(frozen=True)
class MeasuredFitter:
    """Least squares over all unknowns: Levenberg and Marquardt with elimination.

    Attributes:
        priors: Of the instruments.
        iterations: Largest number of steps.
        tolerance: Change of the cost at which it ends.
        with_gyro: Whether yaw rates are used beside positions.
    """

    priors: InstrumentPriors = InstrumentPriors()
    iterations: int = 40
    tolerance: float = 0.01
    with_gyro: bool = False

    def __post_init__(self) -> None:
        require_switch("with_gyro", self.with_gyro)

    def __call__(
        self,
        simulator: RideSimulator,
        windows: RideWindows,
        start: RideUnknowns | None = None,
        tilt: Float[Tensor, "r s"] | None = None,
    ) -> MeasuredFit:
        """Fit the parameters of the simulator to windows that do not overlap.

        The shared unknowns maximise the evidence, not the joint density of all unknowns, where a
        first search ends.

        Args:
            simulator: Of the model.
            windows: The windows.
            start: Where to begin; the priors and the recorded positions by default, and which
                windows coast is decided again after a first fit.
            tilt: That of an earlier fit of these recordings, if there is one.
        """
        point = start or self.first_point(simulator, windows)
        taken = 0
        if start is None:
            first = self._lowest(self._equations(simulator, windows, point, tilt), point)
            point, taken = self.coasting_again(simulator, windows, first.at.point), first.taken
        equations = self._equations(simulator, windows, point, tilt)
        found = self._lowest(equations, point)
        if tilt is None:
            equations, found = self._of_most_evidence(equations, found)
        return self._result(equations, found.at, taken + found.taken, found.converged)

    def _of_most_evidence(
        self, equations: RideEquations, found: _Lowest
    ) -> tuple[RideEquations, _Lowest]:
        """Tilts until the slope of the volume is that where the search ends.

        The volume is not linear: one tilt, taken where the joint density is largest, may lead far
        past the optimum. So each tilt is changed only as far as the evidence rises.
        """
        most, change = evidence(equations, found.at), tilt_change(equations, found.at)
        share, taken = 1.0, found.taken
        while share >= LEAST_SHARE and change.gain >= LEAST_GAIN:
            tilt = equations.tilt + share * change.tilt
            point = found.at.point
            tilted = self._equations(equations.simulator, equations.windows, point, tilt)
            trial = self._lowest(tilted, point)
            taken, reached = taken + trial.taken, evidence(tilted, trial.at)
            if reached < most + LEAST_GAIN:
                share *= 0.5
            else:
                equations, found, most = tilted, trial, reached
                change = tilt_change(equations, found.at)
        return equations, found._replace(taken=taken)

    def result(
        self,
        simulator: RideSimulator,
        windows: RideWindows,
        point: RideUnknowns,
        tilt: Float[Tensor, "r s"],
        taken: int,
        converged: bool,
    ) -> MeasuredFit:
        """A fit that was found before, from its point.

        Args:
            simulator: Of the model.
            windows: The windows.
            point: Where it ended.
            tilt: Its tilt.
            taken: Iterations that it took.
            converged: Whether it converged.
        """
        equations = self._equations(simulator, windows, point, tilt)
        return self._result(equations, equations.linearised(point), taken, converged)

    def _equations(
        self,
        simulator: RideSimulator,
        windows: RideWindows,
        start: RideUnknowns,
        tilt: Float[Tensor, "r s"] | None,
    ) -> RideEquations:
        return RideEquations(simulator, windows, self.priors, self.with_gyro, start, tilt)

    def _lowest(self, equations: RideEquations, point: RideUnknowns) -> "_Lowest":
        """Where the cost ceases to fall.

        A small step that was damped much proves nothing: it is followed by one from little damping.
        """
        at, taken, falls = equations.linearised(point), 0, True
        first = Damping(FIRST_DAMPING, torch.full_like(at.cost.window, FIRST_DAMPING))
        damping = first
        while falls and taken < self.iterations:
            taken, before = taken + 1, at.cost
            little = max(damping.others, float(damping.window.max())) <= FIRST_DAMPING
            for _ in range(STEPS_BACK):
                trial = equations.trial(at, damping)
                cost = equations.cost(trial)
                damping = damping.after(before, cost)
                if cost.total < before.total:
                    at = equations.linearised(trial)
                    break
            small = before.total - at.cost.total < self.tolerance
            falls, damping = not (small and little), first if small else damping
            logger.debug("step %d: cost %.3f", taken, at.cost.total)
        return _Lowest(at, taken, not falls)

    def coasting_again(
        self, simulator: RideSimulator, windows: RideWindows, point: RideUnknowns
    ) -> RideUnknowns:
        """The same vehicle and instruments, and which windows coast under them."""
        return self.first_point(simulator, windows, point.shared, recording=point.recording)

    def first_point(
        self,
        simulator: RideSimulator,
        windows: RideWindows,
        shared: Float[Tensor, " s"] | None = None,
        recording: Float[Tensor, "r 4"] | None = None,
        coasting: Bool[Tensor, " w"] | None = None,
    ) -> RideUnknowns:
        """Each window fitted for itself, vehicle and instruments given.

        Args:
            simulator: Of the model.
            windows: The windows.
            shared: Vehicle and antenna; the priors by default.
            recording: Its instruments; means over its windows by default.
            coasting: Which windows coast; what has more evidence by default.
        """
        vector = SharedUnknowns(simulator.parameters, self.priors)
        shared = vector.start() if shared is None else shared
        mean, std = self.priors.recording()
        precision = std.pow(-2).diag()
        if recording is None:
            each = mean.expand(len(windows.names), -1)
            found = self._windows(simulator, windows, shared, each, precision)
            recording = _means(found.recording, windows, mean)
        found = self._windows(simulator, windows, shared, recording, SURE * precision, coasting)
        return RideUnknowns(shared, recording, without_recording(found.local), found.coasting)

    def _windows(
        self,
        simulator: RideSimulator,
        windows: RideWindows,
        shared: Float[Tensor, " s"],
        recording: Float[Tensor, "r 4"],
        precision: Float[Tensor, "4 4"],
        coasting: Bool[Tensor, " w"] | None = None,
    ) -> WindowEstimate:
        own = recording[windows.recording]
        sure = precision.expand(len(own), -1, -1)
        freewheel = FreewheelGiven.of(self.priors, len(own))
        prior = InstrumentsGiven(own, sure, freewheel, CourseGiven.unknown(len(own)))
        return estimate_windows(
            simulator, windows, shared, prior, self.with_gyro, coasting=coasting
        )

    def _result(
        self, equations: RideEquations, at: Linearisation, taken: int, converged: bool
    ) -> MeasuredFit:
        """Deviations and evidence at the end."""
        parts, point, windows = equations.eliminated(at), at.point, equations.windows
        square = at.system.residual.square().sum()
        factor = max(1.0, float((square / (2 * windows.known.sum())).sqrt()))
        information = parts.reduced.information.sum(0)
        eye = torch.eye(len(information), dtype=information.dtype)
        whole = information / factor**2 + eye
        covariance, gain = torch.linalg.inv(whole), parts.rest[..., :-1]
        spread = torch.linalg.inv(parts.corner) * factor**2 + gain @ covariance @ gain.mT
        found = equations.simulator.simulate(windows, point.shared, point.local(windows.recording))
        apart = (found.position - windows.position).square().sum(-1)[windows.known]
        unknowns, recording_std = equations.shared, spread.diagonal(dim1=-2, dim2=-1).sqrt()
        return MeasuredFit(
            point=point,
            unknowns=unknowns,
            laplace_std=unknowns.std * covariance.diagonal().sqrt(),
            jackknife_std=jackknife(unknowns.values, unknowns, point.shared, parts.reduced),
            covariance=covariance,
            recording_std=recording_std,
            reduced=parts.reduced,
            log_evidence=evidence(equations, at) - 0.5 * float(torch.logdet(whole)),
            rms_m=float(apart.mean().sqrt()),
            noise_factor=factor,
            tilt=equations.tilt,
            iterations=taken,
            converged=converged,
            sizes=noise_sizes(equations, at, parts),
            instruments=learned_instruments(equations, at, parts, recording_std, self.priors),
            noise=heard_noise(windows, found.yaw_rate, equations.simulator.noise),
        )


def _means(
    values: Float[Tensor, "w 4"], windows: RideWindows, otherwise: Float[Tensor, " 4"]
) -> Float[Tensor, "r 4"]:
    """Means of the windows of each recording; a recording without windows has another value."""
    count = torch.bincount(windows.recording, minlength=len(windows.names)).unsqueeze(-1)
    total = values.new_zeros(len(windows.names), values.shape[-1])
    total = total.index_add(0, windows.recording, values)
    return torch.where(count > 0, total / count.clamp_min(1), otherwise)
