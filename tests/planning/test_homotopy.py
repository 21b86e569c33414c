"""Homotopy classes of plans around agents."""

import pytest
import torch

from diffstack_mmv.planning import best_of_each, homotopy_class


def straight(y, times=9):
    """A path along x at height y."""
    x = torch.linspace(-2, 2, times)
    return torch.stack([x, torch.full_like(x, y)], -1)


def test_passing_left_and_right_are_different_classes():
    plans = torch.stack([straight(0.5), straight(0.7), straight(-0.5)])[None]
    agent = torch.zeros(1, 1, 9, 2)
    left, also_left, right = homotopy_class(plans, agent)[0].tolist()
    assert left == also_left != right


def test_passing_before_and_behind_a_pedestrian_are_different_classes():
    agent = straight(0.0).flip(-1)[None, None]
    fast, slow = straight(0.0) + torch.tensor([0.8, 0.0]), straight(0.0) - torch.tensor([0.8, 0.0])
    first, second = homotopy_class(torch.stack([fast, slow])[None], agent)[0].tolist()
    assert first != second


def test_agents_far_away_do_not_tell_classes_apart():
    plans = torch.stack([straight(0.5), straight(-0.5)])[None]
    agent = torch.full((1, 1, 9, 2), 9.0)
    assert homotopy_class(plans, agent).unique().numel() == 1


@pytest.mark.parametrize(
    ("price", "classes", "chosen"),
    [
        ([3.0, 1.0, 2.0, 5.0], [0, 0, 0, 1], [1, 3]),
        ([1.0, 2.0, 3.0, 4.0], [0, 1, 0, 2], [0, 1, 3]),
        ([3.0, 1.0, 2.0], [0, 0, 0], [1, 2, 0]),
    ],
    ids=["two classes", "a class comes again", "others follow where there are fewer classes"],
)
def test_the_cheapest_plan_of_each_class_is_chosen(price, classes, chosen):
    found = best_of_each(torch.tensor([price]), torch.tensor([classes]), len(chosen))
    assert found.tolist() == [chosen]
