"""How sure an estimate is, and what it owes to assumptions."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3
from diffstack_mmv.identification import (
    Identifiability,
    IdentifiabilityThresholds,
    Identifier,
    MultipleShooting,
    profile_likelihoods,
)
from diffstack_mmv.identification.inference.combinations import quantities
from diffstack_mmv.identification.inference.influence import regularisation_influence
from diffstack_mmv.identification.inference.optima import analyse_optimum
from diffstack_mmv.identification.inference.sensitivity import owed_to_priors
from diffstack_mmv.identification.shooting.fit import NO_STOPPING, HeldoutStopping
from tests.identification.conftest import LIVELY, double_precision, synthetic_problem

EVERYTHING = IdentifiabilityThresholds(identifiable=0.4, informed=1.0)


def identified(setup, thresholds=EVERYTHING):
    return Identifier(thresholds=thresholds, starts=0)(setup.simulator, setup.data)


@pytest.fixture(scope="module")
def tyres():
    with double_precision():
        setup = synthetic_problem("gm3", {}, manoeuvres=LIVELY[1:2])
        found = Identifier(MultipleShooting(max_iterations=2), starts=0)(
            setup.simulator, setup.data
        )
    return setup, found


def test_knowing_the_others_never_makes_one_less_certain(tyres):
    sensitivity = tyres[1].sensitivity
    assert bool((sensitivity.conditional_ratio <= sensitivity.marginal_ratio + 1e-9).all())
    assert bool((sensitivity.marginal_ratio <= 1 + 1e-9).all())


def test_information_is_positive_and_sorted(tyres):
    values = [direction.eigenvalue for direction in tyres[1].sensitivity.directions]
    assert values == sorted(values, reverse=True)
    assert values[-1] >= 0


def test_quick_ride_informs_combinations_of_tyre_parameters_rather_than_each(tyres):
    _, found = tyres
    ratio = found.sensitivity.conditional_ratio / found.sensitivity.marginal_ratio
    assert float(ratio.min()) < 0.9
    assert Identifiability.NOT_IDENTIFIABLE in found.identifiability


def test_value_that_was_not_fitted_keeps_its_prior_and_hands_its_error_on(tyres):
    setup, found = tyres
    parameters, theta = setup.simulator.parameters, found.after.theta
    fixed = torch.arange(len(theta)) > 2
    fitted = analyse_optimum(setup.simulator, setup.data.fitted, found.after, ~fixed).sensitivity
    whole = analyse_optimum(setup.simulator, setup.data.fitted, found.after).sensitivity
    none = analyse_optimum(
        setup.simulator, setup.data.fitted, found.after, torch.zeros_like(fixed)
    ).sensitivity
    torch.testing.assert_close(fitted.std[fixed], parameters.prior.std[fixed])
    assert bool((fitted.std >= whole.std * (1 - 1e-9)).all())
    torch.testing.assert_close(none.std, parameters.prior.std)


def test_variance_is_divided_into_that_of_noise_and_that_of_priors(tyres):
    """Of values that are fitted, noise causes Σ S Σ; of the others, priors cause all."""
    setup, found = tyres
    theta = found.after.theta
    active = torch.arange(len(theta)) > 2
    part = analyse_optimum(setup.simulator, setup.data.fitted, found.after, active).sensitivity
    whole = analyse_optimum(setup.simulator, setup.data.fitted, found.after).sensitivity
    expected = whole.covariance @ whole.information @ whole.covariance
    torch.testing.assert_close(whole.of_noise, expected, rtol=1e-6, atol=1e-9)
    rest = part.covariance - part.of_noise
    assert float(torch.linalg.eigvalsh(rest / rest.diagonal().max()).min()) > -1e-9
    owed = owed_to_priors(part.covariance.diagonal(), part.of_noise.diagonal())
    torch.testing.assert_close(owed[~active], torch.ones(3))
    assert bool((owed[active] < 1).all())


def test_combinations_follow_their_formulas(bicycle):
    model = DiffGM3(bicycle).double()
    steer, front, rear, gradient = quantities(model).tolist()
    assert (front, rear) == pytest.approx((11.0, 12.0), rel=1e-6)
    # K = (1 / C_f' - 1 / C_r') / g with the stiffnesses per load
    assert gradient == pytest.approx((1 / 11 - 1 / 12) / 9.81, rel=1e-6)
    assert steer == pytest.approx(1.05 + 25 * gradient, abs=0.06)


@pytest.mark.slow
def test_influence_of_the_steering_prior_predicts_a_new_fit():
    setup = synthetic_problem("kbm", {}, False, steer_rate_radps=0.4)
    found = identified(setup)
    told = regularisation_influence(setup.simulator, setup.data.fitted, found.after, found.active)[
        "steer_rate_radps"
    ]
    wider = synthetic_problem("kbm", {}, False, steer_rate_radps=0.4 * 1.1)
    again = identified(wider)
    values = [setup.simulator.parameters.values(each.after.theta) for each in (found, again)]
    moved = (values[1] - values[0]) / setup.simulator.parameters.prior.std
    expected = told * torch.tensor(1.1).log() / torch.tensor(2.0).log()
    torch.testing.assert_close(moved, expected, rtol=0.35, atol=0.01)


@pytest.mark.slow
def test_profile_is_least_at_the_estimate():
    setup = synthetic_problem("kbm", {"wheelbase": 1.1})
    found = identified(setup)
    shown = profile_likelihoods(
        setup.simulator, setup.data, found, MultipleShooting(max_iterations=6), ["wheelbase"], 7
    )
    profile = shown["wheelbase"]
    best = profile.values[profile.costs.index(min(profile.costs))]
    assert abs(best - 1.1) < 0.06
    assert profile.costs[0] > min(profile.costs) + 2 < profile.costs[-1]


def test_no_held_out_track_ends_the_fits_of_a_profile():
    method = MultipleShooting(stopping=HeldoutStopping(patience=1, significance=1e-3))
    assert method.unstopped() == replace(method, stopping=NO_STOPPING)
    assert NO_STOPPING.significance > 1e6


@pytest.mark.usefixtures("unchecked")  # nothing was identified
def test_profile_of_an_unknown_number_is_refused():
    setup = synthetic_problem("kbm", {}, manoeuvres=LIVELY[:1])
    with pytest.raises(ValueError, match="`profile` must be one of wheelbase, but got 'mass'"):
        profile_likelihoods(setup.simulator, setup.data, None, MultipleShooting(), ["mass"])
