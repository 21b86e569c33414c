"""Combinations of parameters: their deviations follow from those of the parameters."""

from typing import Any

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle
from diffstack_mmv.identification import IdentifiabilityThresholds, ParameterVector
from diffstack_mmv.identification.inference.combinations import combinations, quantities
from diffstack_mmv.identification.inference.optima import LocalOptimum
from diffstack_mmv.identification.inference.sensitivity import Sensitivity
from diffstack_mmv.identification.shooting.fit import ParameterFit


def optimum(theta, covariance, of_noise=1.0, noise_factor=1.0) -> LocalOptimum:
    """A fit of which nothing but θ and the covariance of the values is known."""
    std = covariance.diagonal().sqrt()
    found = Sensitivity(
        covariance, covariance, of_noise * covariance, std, std, std, (), noise_factor
    )
    unknown: Any = None
    fit = ParameterFit(theta, unknown, unknown, ())
    return LocalOptimum(fit, found, noise_factor, 0.0, 0.0)


class Ridden:
    """A bicycle, its numbers, and the combinations of some optima."""

    def __init__(self, spec, dynamics) -> None:
        self.model = dynamics(spec).double()
        self.parameters = ParameterVector(self.model, spec)
        self.start = torch.zeros(len(self.parameters))
        self.prior = self.parameters.prior.std.square().diag()

    def told(self, *optima):
        return combinations(self.model, self.parameters, optima, IdentifiabilityThresholds())

    def at(self, theta):
        self.parameters.store(theta)
        value = quantities(self.model)
        self.parameters.store(self.start)
        return value


@pytest.fixture
def ridden(bicycle) -> Ridden:
    return Ridden(bicycle, DiffKBM)


@pytest.fixture
def tyred(bicycle) -> Ridden:
    return Ridden(bicycle, DiffGM3)


def test_without_a_track_a_combination_is_as_uncertain_as_the_priors_make_it(ridden) -> None:
    for row in ridden.told(optimum(ridden.start, ridden.prior)):
        assert (row.estimate, row.std) == pytest.approx((row.initial, row.prior_std))
        assert row.prior_std > 0
        assert row.verdict == "not identifiable"


def of_one(tyred, theta, name, std) -> LocalOptimum:
    """All values known but one."""
    index = tyred.parameters.names.index(name)
    covariance = torch.zeros_like(tyred.prior)
    covariance[index, index] = std**2
    return optimum(theta, covariance)


@pytest.mark.parametrize(
    ("name", "power"), [("tread_stiffness.front", 1), ("contact_half_length.front", 2)]
)
def test_cornering_stiffness_is_as_uncertain_as_its_factors(tyred, name, power) -> None:
    theta = tyred.start + 0.4
    value = float(tyred.parameters.values(theta)[tyred.parameters.names.index(name)])
    rows = {row.name: row for row in tyred.told(of_one(tyred, theta, name, 0.01 * value))}
    front, rear = (rows[f"normalised_cornering_stiffness.{wheel}"] for wheel in ("front", "rear"))
    assert front.std == pytest.approx(0.01 * power * front.estimate)
    assert rear.std == 0.0


@pytest.mark.parametrize(
    "name", ["tread_stiffness.rear", "contact_half_length.front", "friction.rear"]
)
def test_a_deviation_is_what_a_change_of_the_parameter_makes(tyred, name) -> None:
    theta, parameters = tyred.start + 0.4, tyred.parameters
    step = 1e-3 * parameters.prior.std * torch.tensor([each == name for each in parameters.names])
    values = parameters.values(theta)
    ends = [tyred.at(parameters.theta_for(values + side * step)) for side in (1, -1)]
    rows = tyred.told(of_one(tyred, theta, name, float(step.sum())))
    changes = (0.5 * (ends[0] - ends[1]).abs()).tolist()
    assert [row.std for row in rows] == pytest.approx(changes, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize(
    ("share", "of_noise", "noise_factor", "verdict"),
    [
        (1e-3, 1.0, 1.0, "identifiable"),
        (1e-3, 0.4, 1.0, "only in combination"),
        (1e-3, 1.0, 2.0, "weakly identifiable"),
        (0.3, 1.0, 1.0, "weakly identifiable"),
        (0.5, 1.0, 1.0, "not identifiable"),
    ],
)
def test_a_verdict_is_told_of_a_combination(ridden, share, of_noise, noise_factor, verdict) -> None:
    known = optimum(ridden.start, share**2 * ridden.prior, of_noise, noise_factor)
    assert [row.verdict for row in ridden.told(known)] == [verdict]


@pytest.mark.parametrize("away", [0.1, -0.3])
def test_another_optimum_as_good_widens_a_combination_by_its_distance(ridden, away) -> None:
    sure = 1e-6 * ridden.prior
    both = [optimum(ridden.start, sure), optimum(ridden.start + away, sure)]
    apart = (ridden.at(both[1].fit.theta) - ridden.at(ridden.start)).abs()
    stds = torch.tensor([row.std for row in ridden.told(*both)])
    torch.testing.assert_close(stds, apart / 2**0.5, rtol=1e-2, atol=1e-5)


def test_a_surer_optimum_elsewhere_does_not_make_the_estimate_surer(ridden) -> None:
    sure, unsure = (optimum(ridden.start, share * ridden.prior) for share in (1e-6, 1e-2))
    [alone, both] = ridden.told(unsure), ridden.told(unsure, sure)
    assert [row.std for row in both] == pytest.approx([row.std for row in alone])


def test_a_model_without_combinations_tells_none(bicycle) -> None:
    plain = Ridden(bicycle, ExtendedUnicycle)
    assert plain.told(optimum(plain.start, plain.prior)) == []


def test_a_combination_of_which_nothing_is_learned_is_not_identifiable(bicycle) -> None:
    model = DiffKBM(bicycle).double()
    nothing = ParameterVector(model, bicycle, names=())
    known = optimum(torch.zeros(0), torch.zeros(0, 0))
    (row,) = combinations(model, nothing, [known], IdentifiabilityThresholds())
    assert (row.estimate, row.std, row.verdict) == (row.initial, 0.0, "not identifiable")
