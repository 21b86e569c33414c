"""Joint fit of a vehicle, its instruments and all windows: Gauss-Newton with elimination.

The unknowns of a window are eliminated first, then those of its recording, as tracks are in
multiple shooting; what remains is the information about the vehicle and the antenna.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.measured.estimation import (
    WindowSystem,
    local_prior,
    residuals,
    start_values,
)
from diffstack_mmv.identification.measured.instruments import SIZES, InstrumentPriors
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import (
    ANTENNA,
    POSE,
    RECORDING,
    Linearised,
    RideSimulator,
)
from diffstack_mmv.identification.shooting import ParameterVector

STEPS_BACK = 9


class RideUnknowns(NamedTuple):
    """Values of all unknowns."""

    shared: Float[Tensor, " s"]
    recording: Float[Tensor, "r 4"]
    window: Float[Tensor, "w k"]  # pose, errors of the controls

    def local(self, owner: Tensor) -> Float[Tensor, "w l"]:
        """Unknowns of windows in one row."""
        own = self.recording[owner]
        return torch.cat([self.window[:, :POSE], own, self.window[:, POSE:]], -1)

    def moved(self, step: "RideUnknowns") -> "RideUnknowns":
        """A step away."""
        return RideUnknowns(*(value + way for value, way in zip(self, step, strict=True)))


class Reduced(NamedTuple):
    """Quadratic cost of the shared unknowns per recording, all else eliminated."""

    information: Float[Tensor, "r s s"]
    gradient: Float[Tensor, "r s"]


class MeasuredFit(NamedTuple):
    """A fit of all windows.

    Attributes:
        point: All unknowns.
        shared_std: Deviations of the shared ones, those of the vehicle in physical units.
        covariance: In those units.
        recording_std: Deviations of the unknowns of the recordings.
        reduced: What each recording says about the shared unknowns, in θ.
        log_evidence: By Laplace's approximation.
        rms_m: Root mean square distance between positions and fit.
        noise_factor: Residuals over assumed noise, at least 1.
        iterations: Steps of Levenberg and Marquardt.
        prior: Information of the prior of the shared unknowns, in θ.
        prior_gradient: Gradient of that prior.
        sizes: Deviations of noise that explain its residuals and errors better than the assumed.
    """

    point: RideUnknowns
    shared_std: Float[Tensor, " s"]
    covariance: Float[Tensor, "s s"]
    recording_std: Float[Tensor, "r 4"]
    reduced: Reduced
    log_evidence: float
    rms_m: float
    noise_factor: float
    iterations: int
    prior: Float[Tensor, "s s"]
    prior_gradient: Float[Tensor, " s"]
    sizes: dict[str, float]

    def shared_without(self, recordings: Tensor) -> Float[Tensor, " s"]:
        """Shared unknowns had some recordings (r, mask) been left out: one Newton step."""
        kept = self.reduced.information[~recordings].sum(0) + self.prior
        push = self.reduced.gradient[~recordings].sum(0) + self.prior_gradient
        return self.point.shared - torch.linalg.solve(kept, push)


@dataclass(frozen=True)
class MeasuredFitter:
    """Least squares over all unknowns.

    Attributes:
        priors: Of the instruments.
        iterations: Largest number of Gauss-Newton steps.
        tolerance: Change of the cost at which it ends.
        with_gyro: Whether yaw rates are used beside positions.
    """

    priors: InstrumentPriors = InstrumentPriors()
    iterations: int = 10
    tolerance: float = 0.3
    with_gyro: bool = False

    def __call__(
        self, simulator: RideSimulator, windows: RideWindows, start: RideUnknowns | None = None
    ) -> MeasuredFit:
        """Fit the parameters of the simulator to windows that do not overlap."""
        point = start or self.first_point(simulator, windows)
        problem = _Problem(simulator, windows, self.priors, self.with_gyro, point)
        state, taken = problem.state(point), 0
        damping = 1e-4
        for _ in range(self.iterations):
            taken, before = taken + 1, state.cost
            for _ in range(STEPS_BACK):
                trial = problem.within(state.point.moved(problem.step(state, damping)))
                if problem.cost(trial) < before:
                    state, damping = problem.state(trial), 0.1 * damping
                    break
                damping = max(10 * damping, 1e-3)
            if before - state.cost < self.tolerance:
                break
        return problem.result(state, taken)

    def first_point(self, simulator: RideSimulator, windows: RideWindows) -> RideUnknowns:
        """Priors, and poses as recorded."""
        mean, _ = self.priors.recording()
        each = mean.expand(len(windows.names), -1).clone()
        local = start_values(windows, simulator, each[windows.recording])
        antenna, _ = self.priors.antenna()
        window = torch.cat([local[:, :POSE], local[:, POSE + RECORDING :]], -1)
        return RideUnknowns(
            torch.cat([simulator.parameters.start().double(), antenna]), each, window
        )


class _State(NamedTuple):
    """A point with its linearised system."""

    point: RideUnknowns
    system: WindowSystem
    cost: float


class _Problem:
    """Cost and Newton steps at points."""

    def __init__(
        self,
        simulator: RideSimulator,
        windows: RideWindows,
        priors: InstrumentPriors,
        with_gyro: bool,
        start: RideUnknowns,
    ) -> None:
        self.simulator, self.windows, self.with_gyro = simulator, windows, with_gyro
        self.mean, self.std = priors.recording()
        self.antenna_mean, self.antenna_std = priors.antenna()
        owner = windows.recording
        free = torch.zeros(len(owner), RECORDING, RECORDING, dtype=torch.float64)
        local = start.local(owner)
        prior = local_prior(local, start.recording[owner], free, simulator.noise)
        self.window_mean = _without_recording(prior.mean)
        both = _without_recording(prior.precision)
        self.window_precision = _without_recording(both.mT).mT

    @property
    def parameters(self) -> ParameterVector:
        """The learned parameters."""
        return self.simulator.parameters

    def penalties(self, point: RideUnknowns) -> list[Tensor]:
        """Residuals of the priors of shared and recordings' unknowns, in deviations."""
        theta, antenna = point.shared[:-ANTENNA], point.shared[-ANTENNA:]
        return [
            self.parameters.penalty(theta),
            (antenna - self.antenna_mean) / self.antenna_std,
            ((point.recording - self.mean) / self.std).flatten(),
        ]

    def cost(self, point: RideUnknowns) -> float:
        """Half the sum of all squares."""
        found = self.simulator.simulate(
            self.windows, point.shared, point.local(self.windows.recording)
        )
        outputs = torch.cat([found.position.flatten(1), found.yaw_rate], -1)
        none = outputs.new_zeros(*outputs.shape, 0)
        system = residuals(
            self.windows, Linearised(outputs, none, none), self.simulator.noise, self.with_gyro
        )
        return self._cost(point, system.residual)

    def state(self, point: RideUnknowns) -> _State:
        """Linearise."""
        local = point.local(self.windows.recording)
        found = self.simulator.linearise(self.windows, point.shared, local)
        system = residuals(self.windows, found, self.simulator.noise, self.with_gyro)
        return _State(point, system, self._cost(point, system.residual))

    def _cost(self, point: RideUnknowns, residual: Tensor) -> float:
        gap = point.window - self.window_mean
        inner = torch.einsum("wi,wij,wj->", gap, self.window_precision, gap)
        total = residual.square().sum() + inner
        return 0.5 * float(total + sum(part.square().sum() for part in self.penalties(point)))

    def within(self, point: RideUnknowns) -> RideUnknowns:
        """Keep θ where the soft clamp has a slope."""
        theta = point.shared[:-ANTENNA]
        kept = self.parameters.theta_for(self.parameters.values(theta))
        return point._replace(shared=torch.cat([kept, point.shared[-ANTENNA:]]))

    def shared_prior(self, shared: Tensor) -> tuple[Tensor, Tensor]:
        """Gradient and information of the prior of the shared unknowns."""
        theta, antenna = shared[:-ANTENNA], shared[-ANTENNA:]
        slope = self.parameters.slope(theta) / self.parameters.prior.std
        gradient = [slope * self.parameters.penalty(theta)]
        gradient.append((antenna - self.antenna_mean) / self.antenna_std**2)
        return torch.cat(gradient), torch.cat([slope, 1 / self.antenna_std]).square().diag()

    def eliminated(self, state: _State, damping: float = 0.0) -> "_Eliminated":
        """Eliminate windows, then recordings; the diagonals of both may be damped."""
        own = slice(POSE, POSE + RECORDING)
        system = state.system
        inner = _without_recording(system.local)
        outer = torch.cat([system.shared, system.local[..., own]], -1)
        hessian = _damped(inner.mT @ inner + self.window_precision, damping)
        gap = (state.point.window - self.window_mean).unsqueeze(-1)
        gradient = inner.mT @ system.residual.unsqueeze(-1) + self.window_precision @ gap
        cross = inner.mT @ outer
        solved = torch.linalg.solve(hessian, torch.cat([cross, gradient], -1))
        block = outer.mT @ outer - cross.mT @ solved[..., :-1]
        slope = outer.mT @ system.residual.unsqueeze(-1) - cross.mT @ solved[..., -1:]
        count, size = len(self.windows.names), outer.shape[-1]
        owner = self.windows.recording
        whole = block.new_zeros(count, size, size).index_add(0, owner, block)
        push = block.new_zeros(count, size).index_add(0, owner, slope.squeeze(-1))
        shared = system.shared.shape[-1]
        away = (state.point.recording - self.mean) / self.std**2
        corner = _damped(whole[:, shared:, shared:] + self.std.pow(-2).diag(), damping)
        side = torch.cat([whole[:, shared:, :shared], (push[:, shared:] + away).unsqueeze(-1)], -1)
        rest = torch.linalg.solve(corner, side)
        information = whole[:, :shared, :shared] - side[..., :-1].mT @ rest[..., :-1]
        gradient_r = push[:, :shared] - (side[..., :-1].mT @ rest[..., -1:]).squeeze(-1)
        return _Eliminated(Reduced(information, gradient_r), solved, hessian, corner, rest)

    def step(self, state: _State, damping: float) -> RideUnknowns:
        """Levenberg-Marquardt step of all unknowns."""
        parts = self.eliminated(state, damping)
        push, prior = self.shared_prior(state.point.shared)
        whole = _damped(parts.reduced.information.sum(0) + prior, damping)
        shared = -torch.linalg.solve(whole, parts.reduced.gradient.sum(0) + push)
        recording = -(parts.rest[..., :-1] @ shared) - parts.rest[..., -1]
        outer = torch.cat(
            [shared.expand(len(self.windows.recording), -1), recording[self.windows.recording]], -1
        )
        window = -(parts.solved[..., :-1] @ outer.unsqueeze(-1)).squeeze(-1) - parts.solved[..., -1]
        return RideUnknowns(shared, recording, window)

    def result(self, state: _State, iterations: int) -> MeasuredFit:
        """Deviations and evidence at the end."""
        parts, point = self.eliminated(state), state.point
        push, prior = self.shared_prior(point.shared)
        known = self.windows.known.sum() * 2
        square = state.system.residual.square().sum()
        factor = max(1.0, float((square / known).sqrt()))
        whole = parts.reduced.information.sum(0) / factor**2 + prior
        covariance = torch.linalg.inv(whole)
        ones = torch.ones_like(self.antenna_std)
        slope = torch.cat([self.parameters.slope(point.shared[:-ANTENNA]), ones])
        covariance = covariance * slope * slope.unsqueeze(-1)
        gain = parts.rest[..., :-1] / slope
        spread = torch.linalg.inv(parts.corner) * factor**2 + gain @ covariance @ gain.mT
        local = point.local(self.windows.recording)
        found = self.simulator.simulate(self.windows, point.shared, local).position
        apart = (found - self.windows.position).square().sum(-1)[self.windows.known]
        volume = [torch.logdet(part).sum() for part in (parts.hessian, parts.corner)]
        evidence = -state.cost - 0.5 * (sum(volume) + torch.logdet(whole))
        spread_window = torch.linalg.inv(parts.hessian)
        return MeasuredFit(
            point,
            covariance.diagonal().sqrt(),
            covariance,
            spread.diagonal(dim1=-2, dim2=-1).sqrt(),
            parts.reduced,
            float(evidence + 0.5 * torch.logdet(prior)),
            float(apart.mean().sqrt()),
            factor,
            iterations,
            prior,
            push,
            self.sizes(state, spread_window),
        )

    def sizes(self, state: _State, covariance: Tensor) -> dict[str, float]:
        """Deviations of maximal evidence (one step of expectation and maximisation)."""
        noise, inner = self.simulator.noise, _without_recording(state.system.local)
        count = 2 * self.windows.position.shape[1]
        explained = ((inner @ covariance) * inner).sum(-1)[:, :count]
        square = (state.system.residual[:, :count].square() + explained).unflatten(1, (-1, 2))
        mean = square[self.windows.known].mean(0).sqrt()
        errors = state.point.window[:, POSE:].square()
        errors = errors + covariance.diagonal(dim1=-2, dim2=-1)[:, POSE:]
        knots = errors.unflatten(1, (2, -1)).mean((0, 2)).sqrt()
        along, across = noise.along_m * mean[0], noise.across_m * mean[1]
        return dict(zip(SIZES, map(float, (along, across, *knots)), strict=True))


class _Eliminated(NamedTuple):
    reduced: Reduced
    solved: Tensor  # of the windows, by shared and recordings' unknowns, and the gradient
    hessian: Tensor  # of the windows
    corner: Tensor  # of the recordings
    rest: Tensor  # of the recordings, by shared unknowns, and the gradient


def _damped(matrix: Float[Tensor, "*b n n"], damping: float) -> Float[Tensor, "*b n n"]:
    """Matrix with its diagonal enlarged."""
    return matrix + damping * torch.diag_embed(matrix.diagonal(dim1=-2, dim2=-1))


def _without_recording(values: Float[Tensor, "*b l"]) -> Float[Tensor, "*b k"]:
    """Columns of the unknowns of windows alone."""
    return torch.cat([values[..., :POSE], values[..., POSE + RECORDING :]], -1)
