"""Sentences about an identification."""

from diffstack_mmv.identification import IdentifiabilityThresholds, Identifier, summarise
from diffstack_mmv.identification.report.remarks import misfit, other_optima
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
    assert other_optima(setup.simulator, found) == []


def test_residuals_above_the_noise_are_named(result):
    found = result[1]
    (remark,) = misfit(found._replace(noise_factor=1.5))
    assert "1.50 times the assumed noise" in remark
    assert misfit(found) == []
