"""How sure an estimate is, and what it owes to assumptions."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3
from diffstack_mmv.identification import Identifier, Shooting, Thresholds, Verdict, profiles
from diffstack_mmv.identification.combinations import quantities
from diffstack_mmv.identification.influence import regularisation_influence
from diffstack_mmv.identification.optima import optimum
from diffstack_mmv.identification.sensitivity import Direction, describe
from tests.identification.conftest import LIVELY, synthetic_case

EVERYTHING = Thresholds(identifiable=0.4, informed=1.0)


def identified(case, thresholds=EVERYTHING):
    return Identifier(thresholds=thresholds, starts=0)(case.tracker, case.data)


@pytest.fixture(scope="module")
def tyres():
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    case = synthetic_case("gm3", {}, manoeuvres=LIVELY[1:2])
    found = Identifier(Shooting(max_iterations=2), starts=0)(case.tracker, case.data)
    torch.set_default_dtype(before)
    return case, found


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
    assert Verdict.NOT_IDENTIFIABLE in found.verdicts


def test_value_that_was_not_fitted_keeps_its_prior_and_hands_its_error_on(tyres):
    case, found = tyres
    parameters, theta = case.tracker.parameters, found.after.theta
    held = torch.arange(len(theta)) > 2
    fitted = optimum(case.tracker, case.data.fitted, found.after, ~held).sensitivity
    whole = optimum(case.tracker, case.data.fitted, found.after).sensitivity
    none = optimum(case.tracker, case.data.fitted, found.after, torch.zeros_like(held)).sensitivity
    torch.testing.assert_close(fitted.std[held], parameters.prior.std[held])
    assert bool((fitted.std >= whole.std * (1 - 1e-9)).all())
    torch.testing.assert_close(none.std, parameters.prior.std)


def test_verdict_needs_a_ratio_and_a_precision():
    thresholds = Thresholds()
    assert thresholds.verdict(0.1, 0.01) is Verdict.IDENTIFIABLE
    assert thresholds.verdict(0.1, 0.05) is Verdict.WEAK
    assert thresholds.verdict(0.9, 0.01) is Verdict.NOT_IDENTIFIABLE


def test_fit_that_does_not_explain_the_tracks_identifies_nothing():
    assert Thresholds().verdict(0.1, 0.01, noise_factor=1.5) is Verdict.WEAK


def test_direction_is_told_by_its_largest_parts():
    told = describe(Direction(1.0, (-0.9, 0.05, 0.4)), ["mass", "drag", "friction"])
    assert told == "+0.90 mass, -0.40 friction"


def test_combinations_follow_their_formulas(bicycle):
    model = DiffGM3(bicycle).double()
    steer, front, rear, gradient = quantities(model).tolist()
    assert (front, rear) == pytest.approx((11.0, 12.0), rel=1e-6)
    # K = (1 / C_f' - 1 / C_r') / g with the stiffnesses per load
    assert gradient == pytest.approx((1 / 11 - 1 / 12) / 9.81, rel=1e-6)
    assert steer == pytest.approx(1.05 + 25 * gradient, abs=0.06)


def test_influence_of_the_steering_prior_predicts_a_new_fit():
    case = synthetic_case("kbm", {}, False, steer_rate_radps=0.4)
    found = identified(case)
    told = regularisation_influence(case.tracker, case.data.fitted, found.after, found.active)[
        "steer_rate_radps"
    ]
    wider = synthetic_case("kbm", {}, False, steer_rate_radps=0.4 * 1.1)
    again = identified(wider)
    values = [case.tracker.parameters.values(each.after.theta) for each in (found, again)]
    moved = (values[1] - values[0]) / case.tracker.parameters.prior.std
    expected = told * torch.tensor(1.1).log() / torch.tensor(2.0).log()
    torch.testing.assert_close(moved, expected, rtol=0.35, atol=0.01)


def test_profile_is_least_at_the_estimate():
    case = synthetic_case("kbm", {"wheelbase": 1.1})
    found = identified(case)
    shown = profiles(case.tracker, case.data, found, Shooting(max_iterations=6), ["wheelbase"], 7)
    profile = shown["wheelbase"]
    best = profile.values[profile.costs.index(min(profile.costs))]
    assert abs(best - 1.1) < 0.06
    assert profile.costs[0] > min(profile.costs) + 2 < profile.costs[-1]


def test_profile_of_an_unknown_number_is_refused():
    case = synthetic_case("kbm", {}, manoeuvres=LIVELY[:1])
    with pytest.raises(ValueError, match="`profile` must be one of wheelbase, but got 'mass'"):
        profiles(case.tracker, case.data, None, Shooting(), ["mass"])
