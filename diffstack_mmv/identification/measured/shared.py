"""Unknowns that all recordings share: parameters of the vehicle, and what is installed on it."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.measured.instruments import InstrumentPriors
from diffstack_mmv.identification.measured.simulator import INSTALLED
from diffstack_mmv.identification.shooting import ParameterVector, StepBounds

FAR = 1e6
"""Bound of what has no range, in prior deviations."""


class SharedUnknowns:
    """Rows (s): θ of the vehicle, then ahead and height of the antenna in m, gain of the encoder.

    Steps are taken in prior deviations of the physical values: there the priors are quadratic, and
    a saturated soft clamp adds no curvature.

    Args:
        parameters: Of the vehicle.
        priors: Of antenna and encoder.
    """

    def __init__(self, parameters: ParameterVector, priors: InstrumentPriors) -> None:
        self.parameters = parameters
        self._mean, self._std = priors.installed()

    def start(self) -> Float[Tensor, " s"]:
        """The model as it is, the instruments at their priors."""
        return torch.cat([self.parameters.start().double(), self._mean])

    def split(self, shared: Float[Tensor, " s"]) -> tuple[Tensor, Tensor]:
        """θ, and antenna and encoder."""
        return shared[:-INSTALLED], shared[-INSTALLED:]

    def penalty(self, shared: Float[Tensor, " s"]) -> Float[Tensor, " s"]:
        """Distances from the priors in deviations."""
        theta, installed = self.split(shared)
        return torch.cat([self.parameters.penalty(theta), (installed - self._mean) / self._std])

    def scale(self, shared: Float[Tensor, " s"]) -> Float[Tensor, " s"]:
        """Derivative of the unknowns by their values in prior deviations."""
        theta, _ = self.split(shared)
        return torch.cat([self.parameters.prior.std / self.parameters.slope(theta), self._std])

    @property
    def std(self) -> Float[Tensor, " s"]:
        """Prior deviations in physical units."""
        return torch.cat([self.parameters.prior.std, self._std])

    def values(self, shared: Float[Tensor, " s"]) -> Float[Tensor, " s"]:
        """Physical values."""
        theta, installed = self.split(shared)
        return torch.cat([self.parameters.values(theta), installed])

    def bounds(self, shared: Float[Tensor, " s"]) -> StepBounds:
        """How far a step may go, in prior deviations; antenna and encoder are free."""
        box, far = (
            self.parameters.step_bounds(self.split(shared)[0]),
            torch.full_like(self._std, FAR),
        )
        return StepBounds(torch.cat([box.lower, -far]), torch.cat([box.upper, far]))

    def moved(self, shared: Float[Tensor, " s"], step: Float[Tensor, " s"]) -> Float[Tensor, " s"]:
        """A step in prior deviations away, within the ranges."""
        theta, installed = self.split(shared)
        values = self.parameters.values(theta) + self.parameters.prior.std * step[:-INSTALLED]
        return torch.cat(
            [self.parameters.theta_for(values), installed + self._std * step[-INSTALLED:]]
        )
