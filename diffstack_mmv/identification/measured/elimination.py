"""Normal equations of vehicle, instruments and all windows, and their elimination.

The unknowns of a window are eliminated first, then those of its recording, as tracks are in
multiple shooting; what remains is the information about the vehicle and the antenna, in prior
deviations of their physical values.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.identification.measured.estimation import local_prior
from diffstack_mmv.identification.measured.given import FreewheelGiven
from diffstack_mmv.identification.measured.instruments import InstrumentPriors
from diffstack_mmv.identification.measured.residuals import WindowSystem, residuals
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.shared import SharedUnknowns
from diffstack_mmv.identification.measured.simulator import (
    POSE,
    RECORDING,
    Linearised,
    RideSimulator,
)
from diffstack_mmv.identification.shooting import ReducedSystem, bounded_newton_step

LEAST = 1e-3
"""Least damping after a bad step."""


class RideUnknowns(NamedTuple):
    """Values of all unknowns."""

    shared: Float[Tensor, " s"]
    recording: Float[Tensor, "r 4"]
    window: Float[Tensor, "w k"]  # pose, freewheel, errors of the controls
    coasting: Bool[Tensor, " w"]  # whether the vehicle outruns its wheel

    def without(self, recordings: Tensor, owner: Tensor) -> "RideUnknowns":
        """Unknowns of other recordings than these (r, mask), as `RideWindows.without`."""
        kept = ~recordings
        window, coasting = self.window[kept[owner]], self.coasting[kept[owner]]
        return RideUnknowns(self.shared, self.recording[kept], window, coasting)

    def local(self, owner: Tensor) -> Float[Tensor, "w l"]:
        """Unknowns of windows in one row."""
        own = self.recording[owner]
        return torch.cat([self.window[:, :POSE], own, self.window[:, POSE:]], -1)


class Reduced(NamedTuple):
    """Quadratic cost of the shared unknowns per recording, all else eliminated."""

    information: Float[Tensor, "r s s"]
    gradient: Float[Tensor, "r s"]


class Eliminated(NamedTuple):
    """What is left of the equations, and what is needed to go back."""

    reduced: Reduced
    solved: Tensor  # of the windows, by shared and recordings' unknowns, and the gradient
    hessian: Tensor  # of the windows
    corner: Tensor  # of the recordings
    rest: Tensor  # of the recordings, by shared unknowns, and the gradient


class RideCost(NamedTuple):
    """Cost of a point."""

    total: float
    window: Float[Tensor, " w"]  # of each window's residuals and own unknowns


class Linearisation(NamedTuple):
    """A point with its linearised system."""

    point: RideUnknowns
    system: WindowSystem
    cost: RideCost


class Damping(NamedTuple):
    """Shares by which Levenberg and Marquardt enlarge the diagonals.

    Every window has its own: one that a freewheel kinks does not hold the others back.
    """

    others: float  # of recordings and shared unknowns
    window: Float[Tensor, " w"]

    def after(self, before: RideCost, found: RideCost) -> "Damping":
        """Less where the step was good, more where it was bad."""
        good = found.total < before.total
        rose = found.window > before.window + 0.1
        more, less = (10 * self.window).clamp_min(LEAST), 0.1 * self.window
        others = 0.1 * self.others if good else max(10 * self.others, LEAST)
        return Damping(others, torch.where(rose, more, less if good else self.window))


class RideEquations:
    """Cost and Newton steps at points.

    Args:
        simulator: Of the model.
        windows: Windows that do not overlap.
        priors: Of the instruments.
        with_gyro: Whether yaw rates are used beside positions.
        start: Poses near which those of the windows lie.
        tilt: Slope that is added to the cost of each recording, by the shared unknowns in prior
            deviations (see `volume_slopes`); none by default.
    """

    def __init__(
        self,
        simulator: RideSimulator,
        windows: RideWindows,
        priors: InstrumentPriors,
        with_gyro: bool,
        start: RideUnknowns,
        tilt: Float[Tensor, "r s"] | None = None,
    ) -> None:
        self.simulator, self.windows, self.with_gyro = simulator, windows, with_gyro
        self.shared = SharedUnknowns(simulator.parameters, priors)
        self.mean, self.std = priors.recording()
        level = torch.zeros(len(windows.names), len(start.shared), dtype=torch.float64)
        self.tilt = level if tilt is None else tilt
        owner = windows.recording
        free = torch.zeros(len(owner), RECORDING, RECORDING, dtype=torch.float64)
        local = start.local(owner)
        freewheel = FreewheelGiven.of(priors, len(owner))
        prior = local_prior(
            local, start.recording[owner], free, simulator.noise, freewheel, start.coasting
        )
        self.window_mean = without_recording(prior.mean)
        both = without_recording(prior.precision)
        self.window_precision = without_recording(both.mT).mT

    def cost(self, point: RideUnknowns) -> RideCost:
        """Half the sum of all squares; infinite where it is not a number."""
        local = point.local(self.windows.recording)
        found = self.simulator.simulate(self.windows, point.shared, local)
        outputs = torch.cat([found.position.flatten(1), found.yaw_rate], -1)
        none = outputs.new_zeros(*outputs.shape, 0)
        linear = Linearised(outputs, none, none)
        system = residuals(self.windows, linear, self.simulator.noise, self.with_gyro)
        return self._cost(point, system.residual)

    def linearised(self, point: RideUnknowns) -> Linearisation:
        """Linearise."""
        local = point.local(self.windows.recording)
        found = self.simulator.linearise(self.windows, point.shared, local)
        system = residuals(self.windows, found, self.simulator.noise, self.with_gyro)
        scaled = system._replace(shared=system.shared * self.shared.scale(point.shared))
        return Linearisation(point, scaled, self._cost(point, system.residual))

    def _cost(self, point: RideUnknowns, residual: Tensor) -> RideCost:
        gap = point.window - self.window_mean
        inner = torch.einsum("wi,wij,wj->w", gap, self.window_precision, gap)
        window = 0.5 * (residual.square().sum(-1) + inner).nan_to_num(nan=torch.inf)
        away = ((point.recording - self.mean) / self.std).square().sum()
        away = away + self.shared.penalty(point.shared).square().sum()
        return RideCost(float(window.sum() + 0.5 * away + self.tilted(point)), window)

    def tilted(self, point: RideUnknowns) -> Float[Tensor, ""]:
        """What the tilt adds to the cost of a point, beyond a constant."""
        return self.tilt.sum(0) @ self.shared.penalty(point.shared)

    def eliminated(self, at: Linearisation, damping: Damping | None = None) -> Eliminated:
        """Eliminate windows, then recordings; the diagonals of both may be damped."""
        share = Damping(0.0, torch.zeros_like(at.cost.window)) if damping is None else damping
        own = slice(POSE, POSE + RECORDING)
        system = at.system
        inner = without_recording(system.local)
        outer = torch.cat([system.shared, system.local[..., own]], -1)
        hessian = _damped(inner.mT @ inner + self.window_precision, share.window.view(-1, 1, 1))
        gap = (at.point.window - self.window_mean).unsqueeze(-1)
        gradient = inner.mT @ system.residual.unsqueeze(-1) + self.window_precision @ gap
        cross = inner.mT @ outer
        solved = torch.linalg.solve(hessian, torch.cat([cross, gradient], -1))
        block = outer.mT @ outer - cross.mT @ solved[..., :-1]
        slope = outer.mT @ system.residual.unsqueeze(-1) - cross.mT @ solved[..., -1:]
        count, size = len(self.windows.names), outer.shape[-1]
        owner = self.windows.recording
        whole = block.new_zeros(count, size, size).index_add(0, owner, block)
        push = block.new_zeros(count, size).index_add(0, owner, slope.squeeze(-1))
        return self._recordings_eliminated(at, whole, push, share.others, solved, hessian)

    def _recordings_eliminated(
        self,
        at: Linearisation,
        whole: Float[Tensor, "r o o"],
        push: Float[Tensor, "r o"],
        damping: float,
        solved: Tensor,
        hessian: Tensor,
    ) -> Eliminated:
        shared = at.system.shared.shape[-1]
        away = (at.point.recording - self.mean) / self.std**2
        corner = _damped(whole[:, shared:, shared:] + self.std.pow(-2).diag(), damping)
        side = torch.cat([whole[:, shared:, :shared], (push[:, shared:] + away).unsqueeze(-1)], -1)
        rest = torch.linalg.solve(corner, side)
        information = whole[:, :shared, :shared] - side[..., :-1].mT @ rest[..., :-1]
        gradient = push[:, :shared] - (side[..., :-1].mT @ rest[..., -1:]).squeeze(-1)
        gradient = gradient + self.tilt
        return Eliminated(Reduced(information, gradient), solved, hessian, corner, rest)

    def trial(self, at: Linearisation, damping: Damping) -> RideUnknowns:
        """The point a Levenberg-Marquardt step away, the vehicle within its ranges."""
        parts, point = self.eliminated(at, damping), at.point
        push = self.shared.penalty(point.shared)
        information = parts.reduced.information.sum(0)
        eye = torch.eye(len(push), dtype=push.dtype)
        whole = _damped(information + eye, damping.others)
        system = ReducedSystem(whole, parts.reduced.gradient.sum(0) + push)
        shared = bounded_newton_step(system, self.shared.bounds(point.shared))
        return self.followed(point, parts, shared)

    def followed(
        self, point: RideUnknowns, parts: Eliminated, shared: Float[Tensor, " s"]
    ) -> RideUnknowns:
        """The point after a step of the shared unknowns in prior deviations; all else follows."""
        owner = self.windows.recording
        recording = -(parts.rest[..., :-1] @ shared) - parts.rest[..., -1]
        outer = torch.cat([shared.expand(len(owner), -1), recording[owner]], -1)
        window = -(parts.solved[..., :-1] @ outer.unsqueeze(-1)).squeeze(-1) - parts.solved[..., -1]
        return RideUnknowns(
            self.shared.moved(point.shared, shared),
            point.recording + recording,
            point.window + window,
            point.coasting,
        )


def _damped(
    matrix: Float[Tensor, "*b n n"], damping: float | Float[Tensor, "*b 1 1"]
) -> Float[Tensor, "*b n n"]:
    """Matrix with its diagonal enlarged."""
    return matrix + damping * torch.diag_embed(matrix.diagonal(dim1=-2, dim2=-1))


def without_recording(values: Float[Tensor, "*b l"]) -> Float[Tensor, "*b k"]:
    """Columns of the unknowns of windows alone."""
    return torch.cat([values[..., :POSE], values[..., POSE + RECORDING :]], -1)
