"""Unknowns of single windows for a given vehicle: maximum a posteriori by least squares."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.geometry import direction, wrap_angle
from diffstack_mmv.identification.measured.given import (
    UNKNOWN_RAD,
    CourseGiven,
    FreewheelGiven,
    InstrumentsGiven,
)
from diffstack_mmv.identification.measured.instruments import MeasurementNoise
from diffstack_mmv.identification.measured.residuals import PLAIN, ROBUST, residuals
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import (
    COASTING,
    POSE,
    RECORDING,
    Linearised,
    RideSimulator,
)

START_M = 100.0
"""Prior deviation of the position at the start of a window."""

SURE_RAD = 0.5
"""A course that is known so well is searched from, instead of from the way."""

FIRST_DAMPING, AFTER_FAILURE = 1e-4, 1e-2
"""Share of the diagonal that Levenberg's damping adds at first, and least after a failed step."""


class LocalPrior(NamedTuple):
    """Gaussian prior of the unknowns of each window."""

    mean: Float[Tensor, "w l"]
    precision: Float[Tensor, "w l l"]


def where_rows(
    where: Bool[Tensor, " w"], first: Sequence[Tensor], second: Sequence[Tensor]
) -> list[Tensor]:
    """Rows of the first where it is chosen, of the second elsewhere."""
    return [
        torch.where(where.view(-1, *(1,) * (one.dim() - 1)), one, other)
        for one, other in zip(first, second, strict=True)
    ]


class WindowEstimate(NamedTuple):
    """Unknowns of each window with their covariance."""

    local: Float[Tensor, "w l"]
    covariance: Float[Tensor, "w l l"]
    evidence: Float[Tensor, " w"]  # logarithm
    coasting: Bool[Tensor, " w"]
    slopes: Float[Tensor, "w o l"]  # of positions, then yaw rates

    def replaced(self, other: "WindowEstimate", where: Bool[Tensor, " w"]) -> "WindowEstimate":
        """The other's in some windows."""
        return WindowEstimate(*where_rows(where, other, self))

    @property
    def recording(self) -> Float[Tensor, "w 4"]:
        """Steering offset (rad) and scale, speed scale, delay (s)."""
        return self.local[:, POSE : POSE + RECORDING]


def start_values(
    windows: RideWindows,
    simulator: RideSimulator,
    mean: Float[Tensor, "w 4"],
    freewheel: FreewheelGiven,
    coasting: Bool[Tensor, " w"],
) -> Float[Tensor, "w l"]:
    """Unknowns with pose and excess of speed as recorded, and no errors of the controls."""
    ahead = min(windows.steps, 10)
    way = windows.position[:, ahead] - windows.position[:, 0]
    turned = 0.5 * windows.speed[:, 0] * (windows.steer[:, :ahead] + mean[:, :1]).mean(-1)
    course = torch.atan2(way[:, 1], way[:, 0]) - turned * ahead * simulator.model.dt_s
    rest = way.new_zeros(len(way), 2 * simulator.knots(windows.steps))
    at_axle = windows.position[:, 0] - 0.3 * direction(course)
    wheel = mean[:, 2] * windows.speed[:, :ahead].mean(-1)
    excess = way.norm(dim=-1) / (ahead * simulator.model.dt_s) - wheel
    own, _ = freewheel.where(coasting)
    own[:, 0] = torch.where(coasting, excess.clamp_min(0.0), own[:, 0])
    return torch.cat([at_axle, course.unsqueeze(-1), mean, own, rest], -1)


def local_prior(
    start: Float[Tensor, "w l"],
    mean: Float[Tensor, "w 4"],
    precision: Float[Tensor, "w 4 4"],
    noise: MeasurementNoise,
    freewheel: FreewheelGiven,
    coasting: Bool[Tensor, " w"],
) -> LocalPrior:
    """Prior of all unknowns of windows from that of their recordings; the pose is nearly free."""
    known = POSE + RECORDING + COASTING
    count = (start.shape[-1] - known) // 2
    own_mean, spread = freewheel.where(coasting)
    pose = torch.tensor([START_M, START_M, UNKNOWN_RAD], dtype=start.dtype)
    errors = torch.tensor([noise.curvature, noise.speed_share], dtype=start.dtype)
    fixed = torch.cat([pose, torch.ones(RECORDING, dtype=start.dtype)]).expand(len(start), -1)
    knots = errors.repeat_interleave(count).expand(len(start), -1)
    whole = torch.diag_embed(torch.cat([fixed, spread, knots], -1) ** -2)
    own = slice(POSE, POSE + RECORDING)
    whole[:, own, own] = precision
    rest = torch.zeros_like(start[:, known:])
    middle = torch.cat([start[:, :POSE], mean, own_mean, rest], -1)
    return LocalPrior(middle, whole)


def _on_course(
    first: Float[Tensor, "w l"], prior: LocalPrior, course: CourseGiven
) -> tuple[Float[Tensor, "w l"], LocalPrior]:
    """Start values and prior where something is known of the course."""
    column = POSE - 1
    near = first[:, column] + wrap_angle(course.mean - first[:, column])
    known, sure = course.std < UNKNOWN_RAD, course.std < SURE_RAD
    first, mean, precision = first.clone(), prior.mean.clone(), prior.precision.clone()
    first[:, column] = torch.where(sure, near, first[:, column])
    mean[:, column] = torch.where(known, near, mean[:, column])
    precision[:, column, column] = course.std**-2
    return first, LocalPrior(mean, precision)


def estimate_windows(
    simulator: RideSimulator,
    windows: RideWindows,
    shared: Float[Tensor, " s"] | Float[Tensor, "w s"],
    given: InstrumentsGiven,
    with_gyro: bool = False,
    iterations: int = 10,
    coasting: Bool[Tensor, " w"] | None = None,
) -> WindowEstimate:
    """Most probable unknowns of each window by itself, and whether it coasts.

    Args:
        simulator: Of the vehicle.
        windows: The windows.
        shared: θ of the vehicle and place of the antenna, of all windows or of each.
        given: What is known of the instruments.
        with_gyro: Whether the yaw rates are used.
        iterations: Steps of Levenberg and Marquardt.
        coasting: Which windows coast; what has more evidence by default.
    """
    if coasting is not None:
        search = _Search(simulator, windows, shared, given, with_gyro)
        return search.estimate(coasting, iterations)
    # both in one batch
    count = len(given.mean)
    twice = torch.arange(count).repeat(2)
    own = shared if shared.dim() == 1 else shared[twice]
    search = _Search(simulator, windows.select(twice), own, given.select(twice), with_gyro)
    found = search.estimate(torch.arange(2 * count) >= count, iterations)
    driven, coasts = (WindowEstimate(*(part.split(count)[i] for part in found)) for i in (0, 1))
    return driven.replaced(coasts, coasts.evidence > driven.evidence)


def _estimate(
    at: "_Point", prior: LocalPrior, share: Float[Tensor, " w"], coasting: Bool[Tensor, " w"]
) -> WindowEstimate:
    """With the evidence by Laplace's approximation, the share of coasting windows in it."""
    volume = torch.logdet(prior.precision) - torch.logdet(at.hessian)
    evidence = 0.5 * volume - at.cost + torch.where(coasting, share, 1 - share).log()
    covariance = torch.linalg.inv(at.hessian)
    return WindowEstimate(at.local, covariance, evidence, coasting, at.slopes)


class _Point(NamedTuple):
    """Unknowns with the quadratic model of their cost."""

    local: Float[Tensor, "w l"]
    cost: Float[Tensor, " w"]
    gradient: Float[Tensor, "w l"]
    hessian: Float[Tensor, "w l l"]
    outputs: Float[Tensor, "w o"]
    slopes: Float[Tensor, "w o l"]

    def replaced(self, other: "_Point", where: Bool[Tensor, " w"]) -> "_Point":
        """The other's values in some windows."""
        return _Point(*where_rows(where, other, self))


class _Search(NamedTuple):
    """Searches the lowest cost of single windows by Levenberg and Marquardt."""

    simulator: RideSimulator
    windows: RideWindows
    shared: Float[Tensor, " s"] | Float[Tensor, "w s"]
    given: InstrumentsGiven
    with_gyro: bool

    def estimate(self, coasting: Bool[Tensor, " w"], iterations: int) -> WindowEstimate:
        """Estimate for windows that coast or do not."""
        mean, precision, freewheel, course = self.given
        first = start_values(self.windows, self.simulator, mean, freewheel, coasting)
        noise = self.simulator.noise
        prior = local_prior(first, mean, precision, noise, freewheel, coasting)
        first, prior = _on_course(first, prior, course)
        # Huber's cost is flat far from the optimum, so the plain one leads there first
        near = self._lowest(self._point(first, prior, PLAIN), prior, PLAIN, iterations // 2)
        at = self._weighed(near.local, near.outputs, near.slopes, prior, ROBUST)
        at = self._lowest(at, prior, ROBUST, iterations - iterations // 2)
        return _estimate(at, prior, freewheel.share, coasting)

    def _lowest(self, at: _Point, prior: LocalPrior, robust: float, iterations: int) -> _Point:
        """Where each window costs least after some steps."""
        damping = torch.full_like(at.cost, FIRST_DAMPING)
        for _ in range(iterations):
            diagonal = at.hessian.diagonal(dim1=-2, dim2=-1) * damping.unsqueeze(-1)
            step = torch.linalg.solve(at.hessian + torch.diag_embed(diagonal), at.gradient)
            trial = self._point(at.local - step, prior, robust)
            better = trial.cost < at.cost
            damping = torch.where(better, 0.1 * damping, (10 * damping).clamp_min(AFTER_FAILURE))
            at = at.replaced(trial, better)
        return at

    def _point(self, local: Float[Tensor, "w l"], prior: LocalPrior, robust: float) -> _Point:
        """Linearise."""
        found = self.simulator.linearise(self.windows, self.shared, local, by_shared=False)
        return self._weighed(local, found.outputs, found.local, prior, robust)

    def _weighed(
        self, local: Tensor, outputs: Tensor, slopes: Tensor, prior: LocalPrior, robust: float
    ) -> _Point:
        """The quadratic model of the cost of a linearisation."""
        found = Linearised(outputs, slopes[..., :0], slopes)
        system = residuals(self.windows, found, self.simulator.noise, self.with_gyro, robust)
        gap = (local - prior.mean).unsqueeze(-1)
        push = prior.precision @ gap
        gradient = system.local.mT @ system.residual.unsqueeze(-1) + push
        square = system.residual.square().sum(-1) + (gap * push).sum((-2, -1))
        hessian = system.local.mT @ system.local + prior.precision
        return _Point(local, 0.5 * square, gradient.squeeze(-1), hessian, outputs, slopes)
