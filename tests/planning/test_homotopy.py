"""Ways around people."""

import torch
from diffstack_mmv.simulation.homotopy import best_of_each, ways_around


def straight(y, times=9):
    """A path along x at height y."""
    x = torch.linspace(-2, 2, times)
    return torch.stack([x, torch.full_like(x, y)], -1)


def test_passing_left_and_right_are_different_ways():
    plans = torch.stack([straight(0.5), straight(0.7), straight(-0.5)])[None]
    human = torch.zeros(1, 1, 9, 2)
    left, also_left, right = ways_around(plans, human)[0].tolist()
    assert left == also_left != right


def test_passing_before_and_behind_a_walker_are_different_ways():
    human = straight(0.0).flip(-1)[None, None]
    fast, slow = straight(0.0) + torch.tensor([0.8, 0.0]), straight(0.0) - torch.tensor([0.8, 0.0])
    first, second = ways_around(torch.stack([fast, slow])[None], human)[0].tolist()
    assert first != second


def test_people_far_away_do_not_tell_ways_apart():
    plans = torch.stack([straight(0.5), straight(-0.5)])[None]
    human = torch.full((1, 1, 9, 2), 9.0)
    assert ways_around(plans, human).unique().numel() == 1


def test_the_cheapest_plan_of_each_way_is_chosen():
    price = torch.tensor([[3.0, 1.0, 2.0, 5.0]])
    ways = torch.tensor([[0, 0, 0, 1]])
    assert best_of_each(price, ways, 2).tolist() == [[1, 3]]


def test_other_plans_follow_where_there_are_fewer_ways():
    price = torch.tensor([[3.0, 1.0, 2.0]])
    assert best_of_each(price, torch.zeros(1, 3, dtype=torch.long), 3).tolist() == [[1, 2, 0]]
