"""The learnable sum of cost terms."""

import pytest
import torch

from diffstack_mmv.costs import (
    ControlEffort,
    ExpectedCollision,
    ReferenceTracking,
    WeightedCost,
    YawRate,
)
from tests.costs.test_terms import random_case

TERMS = {"tracking": ReferenceTracking(), "effort": ControlEffort(), "yaw": YawRate()}
WEIGHTS = {"tracking": 2.0, "effort": 0.5, "yaw": 0.1}


def test_initial_weights_are_those_asked_for():
    weights = WeightedCost(TERMS, WEIGHTS, frozen=["yaw"]).weights()
    assert {name: pytest.approx(float(weight)) for name, weight in weights.items()} == WEIGHTS


@pytest.mark.parametrize("frozen", [[], ["yaw"], list(TERMS)])
def test_value_is_the_weighted_sum_of_the_terms(frozen):
    case = random_case()
    expected = sum(WEIGHTS[name] * term(*case) for name, term in TERMS.items())
    assert torch.allclose(WeightedCost(TERMS, WEIGHTS, frozen)(*case), expected, atol=1e-5)


def test_terms_are_told_one_by_one_with_their_weights_or_with_others():
    case, others = random_case(), {"tracking": 5.0, "effort": 0.0, "yaw": 7.0}
    cost = WeightedCost(TERMS, WEIGHTS)
    for weights, given in ((WEIGHTS, {}), (others, {"weights": others})):
        for name, value in cost.components(*case, **given).items():
            torch.testing.assert_close(value, weights[name] * TERMS[name](*case))


def test_learning_keeps_weights_positive_and_their_sum_and_spares_the_frozen():
    cost = WeightedCost(TERMS, WEIGHTS, frozen=["yaw"])
    with torch.no_grad():
        cost.log_weight += torch.tensor([-30.0, 4.0])
    weights = cost.weights()
    assert all(weight > 0 for weight in weights.values())
    assert float(weights["tracking"] + weights["effort"]) == pytest.approx(2.5)
    assert weights["yaw"] == 0.1


def test_all_weights_may_be_frozen():
    cost = WeightedCost(TERMS, WEIGHTS, frozen=list(TERMS))
    assert cost.weights() == WEIGHTS
    assert cost.weights() == WEIGHTS
    assert cost.log_weight.numel() == 0


@pytest.mark.parametrize(
    ("weights", "frozen", "told"),
    [
        ({"tracking": 1.0}, [], "`weights` must name the terms"),
        (WEIGHTS | {"yaw": 0.0}, [], "`weights.yaw` must be positive"),
        (WEIGHTS, ["goal"], "`frozen` must be among"),
    ],
)
def test_inconsistent_weights_are_refused(weights, frozen, told):
    with pytest.raises(ValueError, match=told):
        WeightedCost(TERMS, weights, frozen)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("term", "adds"),
    [(ControlEffort(), True), (ExpectedCollision(), False), (torch.nn.Identity(), False)],
)
def test_a_sum_adds_up_components_if_every_term_says_that_it_does(term, adds):
    cost = WeightedCost({"yaw": YawRate(), "other": term}, {"yaw": 1.0, "other": 1.0})
    assert cost.adds_components is adds
