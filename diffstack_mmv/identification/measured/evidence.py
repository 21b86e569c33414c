"""What the recordings say about the noise and the priors of the instruments."""

from dataclasses import replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.identification.measured.elimination import (
    Eliminated,
    Linearisation,
    RideEquations,
    without_recording,
)
from diffstack_mmv.identification.measured.instruments import (
    OF_FREEWHEEL,
    OF_RECORDING,
    SIZES,
    Gaussian,
    InstrumentPriors,
    MeasurementNoise,
)
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import COASTING, POSE

NoiseSizes = dict[str, float]
"""Deviations by the names of `SIZES`."""

LEAST_SHARE = 0.2
"""A learned deviation is at least this share of the given one: recordings are few."""

MOST_ALIKE = 0.9
"""Largest correlation of neighboring steps that is accounted for."""


def noise_sizes(equations: RideEquations, at: Linearisation, parts: Eliminated) -> NoiseSizes:
    """Deviations of maximal evidence (one step of expectation and maximisation)."""
    windows, noise = equations.windows, equations.simulator.noise
    covariance, inner = torch.linalg.inv(parts.hessian), without_recording(at.system.local)
    count = 2 * windows.position.shape[1]
    explained = ((inner @ covariance) * inner).sum(-1)[:, :count]
    square = (at.system.residual[:, :count].square() + explained).unflatten(1, (-1, 2))
    mean = square[windows.known].mean(0).sqrt()
    known = POSE + COASTING
    errors = at.point.window[:, known:].square()
    errors = errors + covariance.diagonal(dim1=-2, dim2=-1)[:, known:]
    knots = errors.unflatten(1, (2, -1)).mean((0, 2)).sqrt()
    along, across = noise.along_m * mean[0], noise.across_m * mean[1]
    return dict(zip(SIZES, map(float, (along, across, *knots)), strict=True))


def heard_noise(
    windows: RideWindows, yaw_rate: Float[Tensor, "w T"], given: MeasurementNoise
) -> MeasurementNoise:
    """Noise and bias of the gyro from the yaw rates of a fit that did not use it.

    The bias is that of recordings. What is left within a window is not white: the deviation is that
    of white noise whose means over windows vary as much.

    Args:
        windows: The fitted windows.
        yaw_rate: Of the fit, rad/s.
        given: The other deviations, and all where there are not two recordings with a gyro.
    """
    apart = windows.yaw_rate - yaw_rate
    heard = apart.isfinite().all(-1)
    owner, apart = windows.recording[heard], apart[heard]
    if len(owner.unique()) < 2:
        return given
    mean = apart.mean(-1)
    bias = torch.stack([mean[owner == number].mean() for number in owner.unique()])
    rest = apart - mean.unsqueeze(-1)
    square = rest.square().mean()
    alike = ((rest[:, 1:] * rest[:, :-1]).mean() / square).clamp(0.0, MOST_ALIKE)
    return replace(
        given,
        yaw_rate_radps=float((square * (1 + alike) / (1 - alike)).sqrt()),
        yaw_rate_bias=Gaussian(float(bias.mean()), float(bias.std())),
    )


class LearnedInstruments(NamedTuple):
    """Moments of the unknowns of recordings and of coasting windows after a fit."""

    given: InstrumentPriors
    recording: Float[Tensor, "r 4"]
    recording_std: Float[Tensor, "r 4"]
    freewheel: Float[Tensor, "w 2"]
    freewheel_std: Float[Tensor, "w 2"]
    coasting: Bool[Tensor, " w"]
    owner: Int[Tensor, " w"]

    def priors(self, left_out: Bool[Tensor, " r"]) -> InstrumentPriors:
        """Priors after a step of expectation and maximisation without some recordings.

        What all recordings share stays at its prior, and so does the mean of their steering scales,
        which is the gain of the encoder.
        """
        kept = ~left_out
        columns = zip(OF_RECORDING, self.recording[kept].T, self.recording_std[kept].T, strict=True)
        found = {name: _gaussian(value, std, self._given(name)) for name, value, std in columns}
        scale = found["steer_scale"].std
        found["steer_scale"] = Gaussian(self.given.steer_scale.mean, scale)
        inside = kept[self.owner]
        coasting = self.coasting & inside
        if not bool(coasting.any()):
            return replace(self.given, **found)
        for column, name in enumerate(OF_FREEWHEEL):
            value, std = self.freewheel[coasting, column], self.freewheel_std[coasting, column]
            found[name] = _gaussian(value, std, self._given(name))
        share = float(self.coasting[inside].double().mean())
        return replace(self.given, **found, coasting_share=share)

    def _given(self, name: str) -> Gaussian:
        return getattr(self.given, name)


def learned_instruments(
    equations: RideEquations,
    at: Linearisation,
    parts: Eliminated,
    recording_std: Tensor,
    given: InstrumentPriors,
) -> LearnedInstruments:
    """What a fit tells about the instruments.

    Args:
        equations: Of the w windows that were fitted.
        at: Their linearisation where the fit ended.
        parts: Their Hessians in the local unknowns, of shape (w, p, p).
        recording_std: Deviations of the instruments of each recording, of shape (r, 4).
        given: Priors under which it was fitted.
    """
    point, own = at.point, slice(POSE, POSE + COASTING)
    spread = torch.linalg.inv(parts.hessian).diagonal(dim1=-2, dim2=-1).sqrt()
    return LearnedInstruments(
        given,
        point.recording,
        recording_std,
        point.window[:, own],
        spread[:, own],
        point.coasting,
        equations.windows.recording,
    )


def _gaussian(values: Tensor, std: Tensor, given: Gaussian) -> Gaussian:
    mean = values.mean()
    spread = float(((values - mean).square() + std.square()).mean().sqrt())
    return Gaussian(float(mean), max(spread, LEAST_SHARE * given.std))
