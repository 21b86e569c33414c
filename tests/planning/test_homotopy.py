"""Homotopy classes of plans around agents."""

import pytest
import torch

from diffstack_mmv.planning import best_of_each, homotopy_class


def straight(y, times=9):
    """A path along x at height y."""
    x = torch.linspace(-2, 2, times)
    return torch.stack([x, torch.full_like(x, y)], -1)


AHEAD = torch.tensor([0.8, 0.0])


@pytest.mark.parametrize(
    ("agent", "plans", "classes"),
    [
        (torch.zeros(9, 2), [straight(0.5), straight(0.7), straight(-0.5)], [0, 0, 1]),
        (straight(0.0).flip(-1), [straight(0.0) + AHEAD, straight(0.0) - AHEAD], [0, 1]),
        (torch.full((9, 2), 9.0), [straight(0.5), straight(-0.5)], [0, 0]),
    ],
    ids=["left and right", "before and behind", "far away"],
)
def test_ways_around_an_agent_are_classes_of_their_own(agent, plans, classes):
    found = homotopy_class(torch.stack(plans)[None], agent[None, None])[0]
    expected = torch.tensor(classes)
    assert torch.equal(found[:, None] == found, expected[:, None] == expected)


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
