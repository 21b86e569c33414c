"""Weights of the training loss."""

import pytest

from diffstack_mmv.stack import LossWeights


@pytest.mark.parametrize(
    ("planning", "control", "plans"),
    [(0.0, 0.0, False), (0.5, 0.0, True), (0.0, 0.5, True), (2.0, 2.0, True)],
)
def test_a_loss_plans_where_any_part_of_it_is_one_of_plans(planning, control, plans):
    assert LossWeights(planning=planning, control=control).plans is plans


@pytest.mark.parametrize("name", ["prediction", "planning", "control", "hindsight"])
def test_a_negative_weight_is_refused_by_its_name(name):
    with pytest.raises(ValueError, match=f"`loss.{name}` must be at least 0"):
        LossWeights(**{name: -0.1})


def test_a_loss_without_any_part_is_refused():
    with pytest.raises(ValueError, match="`loss` must have a positive weight"):
        LossWeights(prediction=0.0, planning=0.0, control=0.0, hindsight=1.0)
