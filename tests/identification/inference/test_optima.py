"""Several optima: found, weighed, combined."""

import pytest
import torch

from diffstack_mmv.identification import Identifier
from diffstack_mmv.identification.inference.optima import (
    analyse_optimum,
    combined_sensitivity,
    is_same_optimum,
    mixture_variance,
    posterior_shares,
    relevant_optima,
)
from diffstack_mmv.identification.shooting.normal_equations import normal_equations
from tests.identification.conftest import double_precision, synthetic_problem


@pytest.fixture(scope="module")
def known():
    with double_precision():
        setup = synthetic_problem("kbm", {"wheelbase": 1.15})
        found = Identifier(starts=2)(setup.simulator, setup.data)
    return setup, found


def another(best, away, cost):
    """The optimum with θ moved and another cost."""
    fit = best.fit._replace(theta=best.fit.theta + away)
    return best._replace(fit=fit, cost=best.cost + cost)


def test_one_optimum_is_found_once_from_every_start(known):
    setup, found = known
    assert len(found.optima) == 1
    torch.testing.assert_close(found.sensitivity.std, found.optima[0].sensitivity.std)


def test_shares_follow_the_costs(known):
    best = known[1].optima[0]._replace(noise_factor=1.0)
    weights = posterior_shares([best, another(best, 0.5, 1.0), another(best, -0.5, 100.0)])
    expected = torch.softmax(torch.tensor([0.0, -1.0, -100.0]), 0)
    torch.testing.assert_close(weights, expected)


def test_larger_noise_makes_costs_differ_less(known):
    best = known[1].optima[0]
    noisy = [each._replace(noise_factor=2.0) for each in (best, another(best, 0.5, 4.0))]
    torch.testing.assert_close(posterior_shares(noisy), torch.softmax(torch.tensor([0.0, -1.0]), 0))


def test_optimum_without_a_share_of_the_posterior_is_none(known):
    best = known[1].optima[0]._replace(noise_factor=1.0)
    near, far = another(best, 0.5, -1.0), another(best, -0.5, 1e7)
    assert relevant_optima([best, far, near]) == (near, best)


def test_a_last_fit_that_ends_at_another_optimum_leaves_the_best_one(known, monkeypatch):
    """The tracks of a fit begin as they were recorded, which led it away from where it was."""
    setup, found = known
    monkeypatch.setattr(
        Identifier, "_searched", lambda _, simulator, data, first, *rest: another(first, 0.5, -5.0)
    )
    best, second = Identifier(starts=1)(setup.simulator, setup.data).optima
    apart = best.fit.theta - second.fit.theta
    torch.testing.assert_close(apart, torch.full_like(apart, 0.5))
    torch.testing.assert_close(second.fit.theta, found.optima[0].fit.theta)


def test_second_optimum_widens_the_deviation_to_its_distance(known):
    setup, found = known
    parameters, best = setup.simulator.parameters, found.optima[0]
    both = [best, another(best, 0.5, 0.0)]
    values = [parameters.values(each.fit.theta) for each in both]
    expected = (best.sensitivity.std.square() + 0.5 * (values[1] - values[0]).square()).sqrt()
    combined = combined_sensitivity(both, parameters)
    torch.testing.assert_close(combined.std, expected)
    torch.testing.assert_close(combined.marginal_ratio, expected / parameters.prior.std)


def test_far_optimum_leaves_the_deviation_of_the_prior(known):
    setup, found = known
    parameters, best = setup.simulator.parameters, found.optima[0]
    combined = combined_sensitivity([best, another(best, -3.0, 0.0)], parameters)
    torch.testing.assert_close(combined.std, parameters.prior.std)


def test_quantity_on_which_optima_agree_keeps_its_variance(known):
    best = known[1].optima[0]
    both = [best, another(best, 0.5, 0.0)]
    variance = torch.tensor([[0.3], [0.3]])
    torch.testing.assert_close(mixture_variance(both, torch.ones(2, 1), variance), variance[0])


def test_optima_are_alike_within_their_accuracy(known):
    setup, found = known
    parameters, best = setup.simulator.parameters, found.optima[0]
    step = best.sensitivity.std / parameters.slope(best.fit.theta)
    assert is_same_optimum(best, another(best, 0.3 * step, 0.0), parameters)
    assert not is_same_optimum(best, another(best, 0.9 * step, 0.0), parameters)


def test_the_volume_of_an_optimum_is_that_of_its_unknowns_and_values_over_their_priors(known):
    setup, found = known
    best, simulator = found.optima[0], setup.simulator
    unknowns, simulated, _ = best.fit.fitted
    jacobian = simulator.jacobian(best.fit.theta, setup.data.fitted, unknowns, simulated)
    local = normal_equations(jacobian, simulated.residual, unknowns).local
    ratio = best.sensitivity.covariance.diagonal().sqrt() / simulator.parameters.prior.std
    assert len(ratio) == 1
    expected = ratio.log().sum() - 0.5 * torch.logdet(local).sum()
    assert best.log_volume == pytest.approx(float(expected))


def test_tracks_inform_of_the_values_as_much_one_by_one_as_together(known, monkeypatch):
    setup, found = known
    told = []
    monkeypatch.setattr(
        "diffstack_mmv.identification.inference.optima.cluster_std",
        lambda *entries: told.append(entries) or torch.zeros_like(entries[-1]),
    )
    best = analyse_optimum(setup.simulator, setup.data.fitted, found.after)
    information, gradient, precision = told[0]
    noise = max(best.noise_factor, 1.0)
    whole = torch.linalg.inv(information.sum(0) / noise**2 + precision.diag())
    torch.testing.assert_close(whole, best.sensitivity.covariance)
    assert len(information) == len(gradient) == 3
    # at the optimum the tracks pull as hard as the prior does
    values = setup.simulator.parameters.values(found.after.theta)
    prior = setup.simulator.parameters.prior
    pull = precision * (values - prior.mean)
    torch.testing.assert_close(gradient.sum(0), -pull, rtol=1e-2, atol=1e-2 * float(pull.abs()))


def test_negative_number_of_starts_is_refused():
    with pytest.raises(ValueError, match="`starts` must be at least 0"):
        Identifier(starts=-1)


@pytest.mark.parametrize("rate", [None, 3.0, 0.5])
def test_a_prior_of_the_steering_is_no_recorded_number(rate):
    """The noise is told of what was recorded: a prior that is hardly felt changes nothing."""
    with double_precision():
        setup = synthetic_problem("kbm", {}, False, steer_rate_radps=rate)
        found = Identifier(starts=0)(setup.simulator, setup.data)
    assert 0.75 < found.optima[0].noise_factor < 1.2
