"""Sentences about an identification."""

import pytest

from diffstack_mmv.dynamics.catalogue import altered, model_of
from diffstack_mmv.identification import (
    IdentifiabilityThresholds,
    Identifier,
    MultipleShooting,
    ParameterVector,
    TrackingModel,
    TrackingSettings,
    TrackSimulator,
    summarise,
)
from diffstack_mmv.identification.inference.excitation import friction_of
from diffstack_mmv.identification.report.remarks import information_directions, misfit, other_optima
from tests.identification.conftest import LIVELY, synthetic_problem


def test_free_steering_is_named_as_the_reason():
    setup = synthetic_problem("kbm", {}, known=False, manoeuvres=LIVELY[:1])
    found = Identifier(starts=0)(setup.simulator, setup.data)
    remarks = summarise(setup.simulator, setup.data, found, IdentifiabilityThresholds())["remarks"]
    assert any("wheelbase is not observable" in each and "free" in each for each in remarks)


def test_estimate_that_depends_on_the_steering_prior_is_not_to_be_trusted():
    setup = synthetic_problem("kbm", {}, False, LIVELY * 3, steer_rate_radps=0.1)
    found = Identifier(thresholds=IdentifiabilityThresholds(informed=1.0), starts=0)(
        setup.simulator, setup.data
    )
    remarks = summarise(setup.simulator, setup.data, found, IdentifiabilityThresholds())["remarks"]
    assert any("`steer_rate_radps`" in each and "Do not trust it" in each for each in remarks)
    assert any("edge of its range" in each for each in remarks)


def test_other_optimum_is_named_with_its_share(result):
    setup, found, _ = result
    best = found.optima[0]
    far = best._replace(fit=best.fit._replace(theta=best.fit.theta + 0.5))
    (remark,) = other_optima(setup.simulator, found._replace(optima=(best, far)))
    assert "50 % of the posterior: wheelbase" in remark
    (remark,) = other_optima(setup.simulator, found._replace(optima=(best, best)))
    assert "50 % of the posterior: no value is a deviation away." in remark
    assert other_optima(setup.simulator, found) == []


@pytest.mark.parametrize("eigenvalue", [4e-33, -2e-17, 0.0])
def test_information_within_rounding_is_none(result, eigenvalue):
    setup, found, _ = result
    weak = found.sensitivity.directions[-1]._replace(eigenvalue=eigenvalue)
    directions = (*found.sensitivity.directions[:-1], weak)
    changed = found._replace(sensitivity=found.sensitivity._replace(directions=directions))
    remarks = information_directions(setup.simulator, changed)
    assert remarks[-2].startswith("Weak direction (none of the prior's information): ")


def test_residuals_above_the_noise_are_named(result):
    found = result[1]
    (remark,) = misfit(found._replace(noise_factor=1.5))
    assert "1.50 times the assumed noise" in remark
    assert "recorded controls are not theirs" in remark
    assert misfit(found) == []


@pytest.mark.parametrize(
    ("dynamics", "friction", "expected"),
    [("kbm", None, 0.8), ("gm3", 0.4, 0.4), ("gm3", None, 0.6)],
    ids=["none", "of the vehicle", "learned"],
)
def test_adhesion_is_judged_by_the_friction_of_the_model(bicycle, dynamics, friction, expected):
    spec = bicycle if friction is None else altered(bicycle, friction=friction)
    model = model_of(spec, dynamics, 0.1).double()
    parameters = ParameterVector(model, spec)
    simulator = TrackSimulator(TrackingModel(model, TrackingSettings()), parameters)
    values = parameters.prior.mean.clone()
    for wheel, value in (("front", 0.5), ("rear", 0.7)):
        if f"friction.{wheel}" in parameters.names:
            values[parameters.names.index(f"friction.{wheel}")] = value
    found = friction_of(simulator, parameters.theta_for(values))
    assert found == pytest.approx(expected)


def test_the_friction_of_the_adhesion_limit_is_told():
    setup = synthetic_problem("gm3", {}, known=False, manoeuvres=LIVELY[:1])
    found = Identifier(MultipleShooting(max_iterations=1), starts=0)(setup.simulator, setup.data)
    summary = summarise(setup.simulator, setup.data, found, IdentifiabilityThresholds())
    assert summary["excitation"]["friction"] == pytest.approx(0.8)
    (remark,) = [each for each in summary["remarks"] if each.startswith("friction is not")]
    assert "% of the adhesion limit μ g, with μ = 0.80" in remark
