"""Combinations of parameters that tracks inform where they do not inform the single ones."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.func import functional_call, jacfwd

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, DynamicsModel
from diffstack_mmv.dynamics.gm3.load import GRAVITY
from diffstack_mmv.identification.inference.optima import LocalOptimum, mixture_variance
from diffstack_mmv.identification.inference.sensitivity import (
    Identifiability,
    IdentifiabilityThresholds,
)
from diffstack_mmv.identification.shooting.parameters import ParameterVector

PACE_MPS = 5.0  # speed at which the steering per curvature is told


class Combination(NamedTuple):
    """A quantity that depends on several parameters, with its standard deviations."""

    name: str
    unit: str
    initial: float
    estimate: float
    std: float
    prior_std: float
    verdict: Identifiability


class _Quantities(nn.Module):
    """The combinations of a model as a function of its parameters."""

    def __init__(self, model: DynamicsModel) -> None:
        super().__init__()
        self.model = model

    def forward(self) -> Float[Tensor, " q"]:
        model = self.model
        if isinstance(model, DiffKBM):
            return model.wheelbase().unsqueeze(0)
        if not isinstance(model, DiffGM3):
            return model.bounds.lower[:0]
        rows = [self._steer_per_curvature(model)]
        if two_axles(model):
            rows += self._stiffness(model)
        return torch.stack(rows)

    @staticmethod
    def _steer_per_curvature(model: DiffGM3) -> Tensor:
        state = model.bounds.lower.new_zeros(model.state_dim)
        state = state + PACE_MPS * torch.nn.functional.one_hot(torch.tensor(2), model.state_dim)
        small = 1e-4
        return model.steer_for(state, state.new_tensor(small)) / small

    @staticmethod
    def _stiffness(model: DiffGM3) -> list[Tensor]:
        spec = model.spec
        tread = model.get_submodule("tread_stiffness")()
        length = model.get_submodule("contact_half_length")()
        each = 2 * tread * length.square()
        ahead = torch.tensor([wheel.x_m > 0 for wheel in spec.wheels])
        front, rear = each[ahead].sum(), each[~ahead].sum()
        wheelbase = spec.front_m + spec.rear_m
        weight = spec.mass_kg * GRAVITY
        front_load = weight * spec.rear_m / wheelbase
        rear_load = weight * spec.front_m / wheelbase
        gradient = spec.mass_kg / wheelbase * (spec.rear_m / front - spec.front_m / rear)
        return [front / front_load, rear / rear_load, gradient]


def quantities(model: DynamicsModel) -> Float[Tensor, " q"]:
    """The combinations at the present parameters of a model."""
    with torch.no_grad():
        return _Quantities(model)()


def two_axles(model: DiffGM3) -> bool:
    """Whether front and rear tyres both carry lateral force."""
    wheels = model.spec.wheels
    return model.spec.front_m > 0 and not any(wheel.caster for wheel in wheels)


def _labels(model: DynamicsModel) -> list[tuple[str, str]]:
    if isinstance(model, DiffKBM):
        return [("steer_per_curvature", "m")]
    if not isinstance(model, DiffGM3):
        return []
    steer = [(f"steer_per_curvature_at_{PACE_MPS:g}_mps", "m")]
    axles = [
        ("normalised_cornering_stiffness.front", "1/rad"),
        ("normalised_cornering_stiffness.rear", "1/rad"),
        ("understeer_gradient", "rad s^2/m"),
    ]
    return steer + (axles if two_axles(model) else [])


def combinations(
    model: DynamicsModel,
    parameters: ParameterVector,
    optima: Sequence[LocalOptimum],
    thresholds: IdentifiabilityThresholds,
) -> list[Combination]:
    """Steering per curvature, normalised cornering stiffnesses C / F_z, understeer gradient.

    Standard deviations by the delta method, widened by what other optima say. The steering angle
    per curvature at 5 m/s holds all that acts as understeer in one number: tyres, yaw damping and
    aligning moment.

    Args:
        model: The dynamics.
        parameters: Its learned numbers.
        optima: The estimate, then others that explain the tracks.
        thresholds: When a quantity counts as informed.
    """
    combined = _Quantities(model)

    def quantities_of(theta: Tensor) -> Tensor:
        return functional_call(combined, parameters.tensors(theta, "model."), ())

    def variance_of(theta: Tensor, covariance: Tensor) -> Tensor:
        rows = jacfwd(quantities_of)(theta) / parameters.slope(theta)
        return (rows @ covariance * rows).sum(-1)

    start = torch.zeros_like(optima[0].fit.theta)
    prior_variance = variance_of(start, parameters.prior.std.square().diag())
    found = optima[0].sensitivity
    all_values = torch.stack([quantities_of(each.fit.theta) for each in optima])
    variances = torch.stack(
        [variance_of(each.fit.theta, each.sensitivity.covariance) for each in optima]
    )
    estimate, initial = all_values[0], quantities_of(start)
    variance = torch.maximum(mixture_variance(optima, all_values, variances), variances[0])
    found_rows = []
    for index, (name, unit) in enumerate(_labels(model)):
        std, prior_std = float(variance[index].sqrt()), float(prior_variance[index].sqrt())
        value = float(estimate[index])
        ratio = std / prior_std if prior_std > 0 else 1.0
        verdict = thresholds.classify(
            ratio, std / abs(value) if value else math.inf, found.noise_factor
        )
        numbers = (float(initial[index]), value, std, prior_std)
        found_rows.append(Combination(name, unit, *numbers, verdict))
    return found_rows
