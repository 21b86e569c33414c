"""What a joint fit found, and how sure it is of it."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.measured.elimination import Reduced, RideUnknowns
from diffstack_mmv.identification.measured.evidence import LearnedInstruments, NoiseSizes
from diffstack_mmv.identification.measured.instruments import InstrumentPriors, MeasurementNoise
from diffstack_mmv.identification.measured.shared import SharedUnknowns
from diffstack_mmv.identification.shooting import ReducedSystem, bounded_newton_step

NEAR = 0.02


class MeasuredFit(NamedTuple):
    """A fit of all windows.

    Attributes:
        point: All unknowns.
        unknowns: What the shared ones are.
        laplace_std: Deviations of the shared ones by Laplace's approximation, physical units.
        jackknife_std: The same from fits that leave one recording out, which trusts neither the
            noise nor that windows of a recording are independent.
        covariance: Of the shared ones by Laplace, in prior deviations.
        recording_std: Deviations of the unknowns of the recordings.
        reduced: What each recording says about the shared unknowns, in prior deviations.
        log_evidence: By Laplace's approximation.
        rms_m: Root mean square distance between positions and fit.
        noise_factor: Residuals over assumed noise, at least 1.
        tilt: Slope of the uncertainty of what was eliminated, see `volume_slopes`.
        iterations: Steps of Levenberg and Marquardt.
        converged: Whether the cost ceased to fall before the iterations were over.
        sizes: Deviations of noise that explain its residuals and errors better than the assumed.
        instruments: What the recordings tell about the priors of their instruments.
        noise: The assumed noise, that of the gyro as the yaw rates of the fit tell it.
    """

    point: RideUnknowns
    unknowns: SharedUnknowns
    laplace_std: Float[Tensor, " s"]
    jackknife_std: Float[Tensor, " s"]
    covariance: Float[Tensor, "s s"]
    recording_std: Float[Tensor, "r 4"]
    reduced: Reduced
    log_evidence: float
    rms_m: float
    noise_factor: float
    tilt: Float[Tensor, "r s"]
    iterations: int
    converged: bool
    sizes: NoiseSizes
    instruments: LearnedInstruments
    noise: MeasurementNoise

    @property
    def priors(self) -> InstrumentPriors:
        """Priors of the instruments that explain its recordings better than the assumed."""
        return self.instruments.priors(torch.zeros(len(self.point.recording), dtype=torch.bool))

    @property
    def shared_std(self) -> Float[Tensor, " s"]:
        """The larger of both deviations of the shared unknowns, physical units."""
        return torch.maximum(self.laplace_std, self.jackknife_std)

    def std_of(self, quantity: Callable[[Tensor], Tensor]) -> float:
        """Deviation of a number that the shared unknowns determine, likewise the larger of two."""
        shared, ways = self.point.shared, NEAR * torch.eye(len(self.covariance)).double()
        moved = [quantity(self.unknowns.moved(shared, way)) for way in ways]
        back = [quantity(self.unknowns.moved(shared, -way)) for way in ways]
        slope = (torch.stack(moved) - torch.stack(back)) / (2 * NEAR)
        laplace = float((slope @ self.covariance @ slope).sqrt())
        other = float(jackknife(quantity, self.unknowns, shared, self.reduced))
        return max(laplace, other)

    def shared_without(self, recordings: Tensor) -> Float[Tensor, " s"]:
        """Shared unknowns had some recordings (r, mask) been left out: one Newton step."""
        return without(self.unknowns, self.point.shared, self.reduced, recordings)


def without(
    unknowns: SharedUnknowns, shared: Float[Tensor, " s"], reduced: Reduced, left_out: Tensor
) -> Float[Tensor, " s"]:
    """Shared unknowns after one Newton step without the information of some recordings."""
    information = reduced.information[~left_out].sum(0)
    eye = torch.eye(len(shared), dtype=shared.dtype)
    push = reduced.gradient[~left_out].sum(0) + unknowns.penalty(shared)
    step = bounded_newton_step(ReducedSystem(information + eye, push), unknowns.bounds(shared))
    return unknowns.moved(shared, step)


def jackknife(
    quantity: Callable[[Tensor], Tensor],
    unknowns: SharedUnknowns,
    shared: Float[Tensor, " s"],
    reduced: Reduced,
) -> Float[Tensor, "*q"]:
    """Deviations from leaving out one recording at a time; zero with a single one."""
    count = len(reduced.gradient)
    names = torch.arange(count)
    values = torch.stack(
        [quantity(without(unknowns, shared, reduced, names == each)) for each in names]
    )
    return ((count - 1) / count * (values - values.mean(0)).square().sum(0)).sqrt()
