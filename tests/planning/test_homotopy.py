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
        (torch.zeros(9, 2), [straight(1.0), straight(-1.0), straight(3.0)], [0, 1, 2]),
    ],
    ids=["left and right", "before and behind", "far away", "left, right or far away"],
)
def test_ways_around_an_agent_are_classes_of_their_own(agent, plans, classes):
    found = homotopy_class(torch.stack(plans)[None], agent[None, None])[0]
    expected = torch.tensor(classes)
    assert torch.equal(found[:, None] == found, expected[:, None] == expected)


def weaving(first, second):
    """A path along x that passes x = -1 and x = 1 at these heights."""
    x = torch.linspace(-2, 2, 9)
    return torch.stack([x, torch.where(x < 0, first, second)], -1)


def test_each_agent_that_is_passed_doubles_the_classes():
    agents = torch.tensor([[-1.0, 0.0], [1.0, 0.0]])[:, None].expand(2, 9, 2)
    sides = [(0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)]
    plans = torch.stack([weaving(*side) for side in sides])
    assert homotopy_class(plans[None], agents[None]).unique().numel() == 4
    # in a batch each plan is told from those of its own problem, among its own agents
    apart = torch.stack([agents[:1], agents[1:]])
    first, second = homotopy_class(plans.expand(2, 4, 9, 2), apart)
    assert (first[0] == first[1]) & (first[2] == first[3]) & (first[0] != first[2])
    assert (second[0] == second[2]) & (second[1] == second[3]) & (second[0] != second[1])


@pytest.mark.parametrize(("distance", "told"), [(1.9, True), (2.1, False)])
def test_an_agent_tells_sides_apart_within_two_metres_of_the_closest_approach(distance, told):
    plans = torch.stack([straight(distance), straight(-distance)])[None]
    left, right = homotopy_class(plans, torch.zeros(1, 1, 9, 2))[0]
    assert bool(left != right) is told


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


def test_the_cheapest_of_each_class_are_those_of_each_problem():
    price = torch.tensor([[3.0, 1.0, 2.0, 5.0], [1.0, 2.0, 3.0, 4.0]])
    classes = torch.tensor([[0, 0, 0, 1], [0, 1, 0, 2]])
    assert best_of_each(price, classes, 3).tolist() == [[1, 3, 2], [0, 1, 3]]
